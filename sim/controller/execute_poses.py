"""Assignments: `x = 1`, POINT, HERE and DECOMPOSE."""

from sim.as_language import syntax as s
from sim.as_language.errors import AsError
from sim.as_language.values import Joints, Pose, Transformation, compose, inverse
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler
from sim.controller.task import Task

# POINT/X and similar: components of the transformation that are copied.
_PARTS = {
    "X": ("x",), "Y": ("y",), "Z": ("z",), "O": ("o",), "A": ("a",), "T": ("t",),
    "OAT": ("o", "a", "t"),
}  # fmt: skip


def compile_assign(statement: s.Assign, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile `x = 1`, `$s = "a"`, `@n = 3`."""
    store = evaluate.store(statement.target)
    if statement.target.kind == "$":
        text = evaluate.text(statement.value)

        def run_text(task: Task) -> int:
            store(task, text(task))
            return at + 1

        return run_text
    real = evaluate.real(statement.value)

    def run(task: Task) -> int:
        store(task, real(task))
        return at + 1

    return run


def compile_point(statement: s.PointStatement, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile POINT p = pose, POINT #j = pose[,#near], POINT/X p = pose."""
    target = statement.target
    store, value = evaluate.store(target), evaluate.pose(statement.value)
    if target.kind == "#":
        near = evaluate.pose(statement.configuration) if statement.configuration else None

        def run_joints(task: Task) -> int:
            store(task, joints_of(value(task), task, near(task) if near else None))
            return at + 1

        return run_joints
    if statement.part:
        return _part(statement, at, evaluate)

    def run(task: Task) -> int:
        store(task, transformation_of(value(task), task))
        return at + 1

    return run


def compile_here(statement: s.Here, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile HERE p, HERE #j and HERE a+p: current pose from the encoders."""
    store = evaluate.store(statement.target)
    if statement.target.kind == "#":

        def run_joints(task: Task) -> int:
            store(task, task.machine.here_joints())
            return at + 1

        return run_joints
    relative = evaluate.pose(statement.relative_to) if statement.relative_to else None

    def run(task: Task) -> int:
        here = task.machine.here()
        if relative is not None:
            here = compose(inverse(transformation_of(relative(task), task)), here)
        store(task, here)
        return at + 1

    return run


def compile_decompose(statement: s.Decompose, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile DECOMPOSE x[k] = pose: six reals from element k on."""
    store = evaluate.store_row(statement.target)
    value = evaluate.pose(statement.value)

    def run(task: Task) -> int:
        store(task, value(task).numbers())
        return at + 1

    return run


def transformation_of(value: Pose, task: Task) -> Transformation:
    """Return the transformation of a pose; joint values use the current BASE and TOOL."""
    if isinstance(value, Transformation):
        return value
    return task.machine.transformation_of(value)


def joints_of(value: Pose, task: Task, near: Pose | None) -> Joints:
    """Return the joint values of a pose, near `near` or else near the current destination.

    Raises AsError E6007, E6008, E6016 if there is no solution.
    """
    if isinstance(value, Joints):
        return value
    return task.machine.joints_of(value, near if isinstance(near, Joints) else None)


def _part(statement: s.PointStatement, at: int, evaluate: ArgumentCompiler) -> Op:
    target = statement.target
    store, value, old = (
        evaluate.store(target),
        evaluate.pose(statement.value),
        evaluate.pose(target),
    )
    names = _PARTS.get(statement.part)

    def run(task: Task) -> int:
        if names is None:
            raise AsError("E0111", f"POINT/{statement.part}")
        source = transformation_of(value(task), task)
        try:
            before = transformation_of(old(task), task)
        except AsError:
            before = Transformation()  # an undefined target starts from zero
        store(task, before._replace(**{name: getattr(source, name) for name in names}))
        return at + 1

    return run

"""Statements that are no instructions: control flow, assignments, CALL and PRINT."""

from collections.abc import Callable

from sim.as_language import expressions
from sim.as_language import syntax as s
from sim.as_language.errors import AsError
from sim.as_language.values import Joints, Transformation, Value, compose, inverse, single
from sim.controller.tasks import Op, Task

# POINT/X and similar: components of the transformation that are copied.
_PARTS = {
    "X": ("x",), "Y": ("y",), "Z": ("z",), "O": ("o",), "A": ("a",), "T": ("t",),
    "OAT": ("o", "a", "t"),
}  # fmt: skip

# --- control flow ---------------------------------------------------------------------------------


def jump_to(at: int) -> Op:
    """Return an unconditional jump to a step."""
    return lambda _: at


def failing(error: AsError) -> Op:
    """Return a step that fails when it is reached."""

    def run(_: Task) -> int:
        raise AsError(error.code, error.detail)

    return run


def compile_test(statement: s.If | s.While | s.Until, at: int) -> Op:
    """Compile `IF condition THEN`, `WHILE condition DO` and `UNTIL condition`."""
    return _unless(expressions.number_of(statement.condition), at + 1, statement.false_at)


def compile_goto(statement: s.Goto, at: int) -> Op:
    """Compile GOTO; a missing label fails when it is executed (E0101)."""
    jump = jump_to(statement.target)
    if statement.target == s.UNRESOLVED:
        jump = failing(AsError("E0101", f"GOTO {statement.label}"))
    elif statement.condition is not None:
        return _unless(expressions.number_of(statement.condition), statement.target, at + 1)
    if statement.condition is None:
        return jump
    condition = expressions.number_of(statement.condition)
    return lambda task: jump(task) if condition(task) else at + 1


def compile_for(statement: s.For, at: int) -> Op:
    """Compile FOR: stores the action of its END in the frame's `loops`."""
    assign, read = expressions.store(statement.variable), expressions.number_of(statement.variable)
    start, stop = expressions.number_of(statement.start), expressions.number_of(statement.stop)
    step, after = expressions.number_of(statement.step), statement.false_at

    def run(task: Task) -> int:
        assign(task, start(task))
        last, by = stop(task), step(task)

        def test(task: Task) -> int:
            value = read(task)
            return at + 1 if (value <= last if by >= 0.0 else value >= last) else after

        def advance(task: Task) -> int:
            assign(task, single(read(task) + by))
            return test(task)

        task.frames[-1].loops[at] = advance
        return test(task)

    return run


def compile_end(statement: s.End, at: int) -> Op:
    """Compile END: jump to the top of a loop, otherwise to the next step."""
    start = statement.start_at
    if statement.of == "WHILE":
        return jump_to(start)
    if statement.of != "FOR":
        return jump_to(at + 1)

    def run(task: Task) -> int:
        advance = task.frames[-1].loops.get(start)
        if advance is None:
            raise AsError("P0141", "the loop was entered by GOTO, its FOR was not executed")
        return advance(task)

    return run


def compile_case(statement: s.CaseStatement, _: int) -> Op:
    """Compile CASE and SCASE: the first branch that holds an equal value."""
    of = expressions.text_of if statement.text else expressions.number_of
    selector = of(statement.selector)
    branches = [
        (tuple(of(value) for value in branch.values), branch.body_at)
        for branch in statement.branches
    ]
    default = statement.default_at

    def run(task: Task) -> int:
        selected = selector(task)
        for values, body_at in branches:
            for value in values:
                if value(task) == selected:
                    return body_at
        return default

    return run


def _unless(condition: Callable[[Task], float], then: int, otherwise: int) -> Op:
    return lambda task: then if condition(task) else otherwise


# --- CALL, RETURN, PRINT --------------------------------------------------------------------------


def compile_call(statement: s.CallStatement, at: int) -> Op:
    """Compile CALL prog(arguments)."""
    bind = expressions.bind_arguments(statement.arguments)
    name = statement.program

    def run(task: Task) -> int:
        program = task.control.unused_program(name, task)
        task.enter(program, bind(task, program.program))
        return at + 1

    return run


def compile_scall(statement: s.Scall, at: int) -> Op:
    """Compile SCALL $name[,result]: with a result, an error code is stored instead of raised."""
    name, bind = expressions.text_of(statement.program), expressions.bind_arguments(())
    store = expressions.store(statement.result) if statement.result else None

    def run(task: Task) -> int:
        caller, code = task.frame, 0.0
        try:
            program = task.control.unused_program(name(task).lower(), task)
            task.enter(program, bind(task, program.program))
        except AsError as error:
            if store is None:
                raise
            code = float(error.number)
        if store is not None:
            frames, task.frames = task.frames, [caller]  # the result is a variable of the caller
            try:
                store(task, code)
            finally:
                task.frames = frames
        return at + 1

    return run


def compile_return(_: s.Return, at: int) -> Op:
    """Compile RETURN: return to the caller; in the main program it ends the cycle."""

    def run(task: Task) -> int:
        task.leave()
        return at

    return run


def compile_print(statement: s.Print, at: int) -> Op:
    """Compile PRINT [device:] items and TYPE items; all devices share one output."""
    layout = expressions.layout(statement.items)

    def run(task: Task) -> int:
        text, feed = layout(task)
        task.hardware.print(text, feed=feed)
        return at + 1

    return run


# --- assignments ----------------------------------------------------------------------------------


def compile_assign(statement: s.Assign, at: int) -> Op:
    """Compile `x = 1`, `$s = "a"`, `@n = 3`."""
    of = expressions.text_of if statement.target.kind == "$" else expressions.number_of
    return _stored(statement.target, of(statement.value), at)


def compile_point(statement: s.PointStatement, at: int) -> Op:
    """Compile POINT p = pose, POINT #j = pose[,#near], POINT/X p = pose."""
    target = statement.target
    if target.kind == "#":
        read = _joints(statement)
    elif statement.part:
        read = _part(statement)
    else:
        read = expressions.place_of(statement.value)
    return _stored(target, read, at)


def compile_here(statement: s.Here, at: int) -> Op:
    """Compile HERE p, HERE #j and HERE a+p: current pose from the encoders."""
    if statement.target.kind == "#":
        return _stored(statement.target, lambda task: task.machine.here_joints(), at)
    relative = expressions.place_of(statement.relative_to) if statement.relative_to else None

    def here(task: Task) -> Transformation:
        place = task.machine.here()
        return compose(inverse(relative(task)), place) if relative else place

    return _stored(statement.target, here, at)


def compile_decompose(statement: s.Decompose, at: int) -> Op:
    """Compile DECOMPOSE x[k] = pose: six reals from element k on."""
    store, value = expressions.store_row(statement.target), expressions.pose_of(statement.value)

    def run(task: Task) -> int:
        store(task, value(task).numbers())
        return at + 1

    return run


def _stored(target: s.Variable, value: Callable[[Task], Value], at: int) -> Op:
    store = expressions.store(target)

    def run(task: Task) -> int:
        store(task, value(task))
        return at + 1

    return run


def _joints(statement: s.PointStatement) -> Callable[[Task], Value]:
    """Return joint values of a pose, near the configuration or else the current destination."""
    value = expressions.pose_of(statement.value)
    near = expressions.pose_of(statement.configuration) if statement.configuration else None

    def read(task: Task) -> Joints:
        pose = value(task)
        configuration = near(task) if near else None
        if isinstance(pose, Joints):
            return pose
        if not isinstance(configuration, Joints):
            configuration = None
        return task.machine.joints_of(pose, configuration)

    return read


def _part(statement: s.PointStatement) -> Callable[[Task], Value]:
    """Return the target with components of a pose; an undefined target starts from zero."""
    value, old = expressions.place_of(statement.value), expressions.place_of(statement.target)
    names = _PARTS.get(statement.part)

    def read(task: Task) -> Transformation:
        if names is None:
            raise AsError("E0111", f"POINT/{statement.part}")
        source = value(task)
        try:
            before = old(task)
        except AsError:
            before = Transformation()
        return before._replace(**{name: getattr(source, name) for name in names})

    return read

"""Compiler from programs to operations, one for each step.

A statement that is no instruction has a function here: control flow, CALL, PRINT, assignments.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from sim.as_language import expressions
from sim.as_language import syntax as s
from sim.as_language.errors import AsError, refuse
from sim.as_language.keywords import BLOCK_STEPS, POINT_PARTS, words
from sim.as_language.lint_rules import nodes
from sim.as_language.memory import bind
from sim.as_language.syntax import Program, SourceFile
from sim.as_language.values import Joints, Transformation, Value, compose, inverse, single
from sim.controller import (
    instructions_motion,
    instructions_paths,
    instructions_signals,
    instructions_tasks,
    instructions_tcp,
    instructions_udp,
)
from sim.controller.instruction import Action, compile_instruction
from sim.controller.tasks import Compiled, Op, Task

INSTRUCTIONS: Mapping[str, Action] = {
    **instructions_motion.INSTRUCTIONS,
    **instructions_paths.INSTRUCTIONS,
    **instructions_signals.INSTRUCTIONS,
    **instructions_tasks.INSTRUCTIONS,
    **instructions_tcp.INSTRUCTIONS,
    **instructions_udp.INSTRUCTIONS,
}

# Dear steps: sockets, trigonometry, text from and to numbers, arithmetic of poses, the arm's pose.
DEAR = words("""
    TCP_LISTEN TCP_ACCEPT TCP_CONNECT TCP_SEND TCP_RECV TCP_CLOSE TCP_END_LISTEN TCP_STATUS
    UDP_SENDTO UDP_RECVFROM
    SIN COS ATAN2 SQRT $ENCODE $DECODE VAL TRANS SHIFT RX RY RZ FRAME DISTANCE INRANGE HERE #HERE
    """)
DEAR_STATEMENTS = (s.PointStatement, s.Here, s.Print)


@lru_cache(maxsize=8)
def compile_file(source: SourceFile) -> Mapping[str, Compiled]:
    """Return the compiled programs of a file; all machines share them."""
    return {name: _compile_program(p) for name, p in source.programs.items()}


def _compile_program(program: Program) -> Compiled:
    """Return a program that can be executed.

    A step that cannot be compiled does not reject the file: it fails when it is reached, as on the
    controller, with its code, program and step. Steps are compiled when first reached, as half of
    a program never is; the operation then replaces the one that compiles it.
    """
    ops: list[Op] = []

    def when_reached(at: int) -> Op:
        def run(task: Task) -> int:
            statement = program.steps[at].statement
            op = _compile(statement, at)
            op = ops[at] = _dear(op) if is_dear(statement) else op
            return op(task)

        return run

    ops += map(when_reached, range(len(program.steps)))
    return Compiled(program, ops)


def is_dear(statement: s.Statement) -> bool:
    """Return whether a step costs more than an assignment: an instruction or function of `DEAR`.

    Further ones in the same step do not count.
    """
    return isinstance(statement, DEAR_STATEMENTS) or any(
        isinstance(node, s.Instruction | s.FunctionCall) and node.name in DEAR
        for node in nodes(statement)
    )


def _dear(op: Op) -> Op:
    """Return an operation that costs the processor time of a dear step."""

    def run(task: Task) -> int:
        after = op(task)
        task.hardware.now_ns += task.hardware.dear_step_ns
        return after

    return run


def _compile(statement: s.Statement, at: int) -> Op:
    try:
        if not isinstance(statement, s.Instruction):
            return _STATEMENTS[type(statement)](statement, at)
        action = INSTRUCTIONS.get(statement.name)
        if action is not None:
            return compile_instruction(action, statement, at)
        known = "unknown" if statement.unknown else "not emulated"
        if statement.name in BLOCK_STEPS:
            known = "a block step of the pendant, which is not emulated"
        return refuse("E0111", f"{statement.name} is {known}")
    except AsError as error:
        return refuse(error.code, error.detail)


# --- control flow ---------------------------------------------------------------------------------


def _jump_to(at: int) -> Op:
    return lambda _: at


def _no_effect(_: s.Comment | s.Do, at: int) -> Op:
    """Compile a comment, and DO, to which UNTIL jumps."""
    return _jump_to(at + 1)


def _leave_branch(statement: s.Else | s.Value | s.Any, _: int) -> Op:
    """Compile ELSE, VALUE and ANY, reached from the branch above."""
    return _jump_to(statement.end_at)


def _test(statement: s.If | s.While | s.Until, at: int) -> Op:
    """Compile `IF condition THEN`, `WHILE condition DO` and `UNTIL condition`."""
    condition, otherwise = expressions.number_of(statement.condition), statement.false_at
    return lambda task: at + 1 if condition(task) else otherwise


def _goto(statement: s.Goto, at: int) -> Op:
    """Compile GOTO; a missing label fails when it is executed (E0101)."""
    jump = _jump_to(statement.target)
    if statement.target == s.UNRESOLVED:
        jump = refuse("E0101", f"GOTO {statement.label}")
    if statement.condition is None:
        return jump
    condition = expressions.number_of(statement.condition)
    return lambda task: jump(task) if condition(task) else at + 1


def _for(statement: s.For, at: int) -> Op:
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


def _end(statement: s.End, at: int) -> Op:
    """Compile END: jump to the top of a loop, otherwise to the next step."""
    start = statement.start_at
    if statement.of == "WHILE":
        return _jump_to(start)
    if statement.of != "FOR":
        return _jump_to(at + 1)

    def run(task: Task) -> int:
        advance = task.frames[-1].loops.get(start)
        if advance is None:
            raise AsError("P0141", "the loop was entered by GOTO, its FOR was not executed")
        return advance(task)

    return run


def _case(statement: s.CaseStatement, _: int) -> Op:
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


# --- CALL, RETURN, PRINT --------------------------------------------------------------------------


def _call(statement: s.CallStatement, at: int) -> Op:
    """Compile CALL prog(arguments)."""
    arguments = [expressions.refer(argument) for argument in statement.arguments]

    def run(task: Task) -> int:
        program = task.control.unused_program(statement.program, task)
        given = [refer(task) for refer in arguments]
        task.enter(program, bind(program.program.parameters, given, program.name))
        return at + 1

    return run


def _scall(statement: s.Scall, at: int) -> Op:
    """Compile SCALL $name[,result]: with a result, an error code is stored instead of raised."""
    name = expressions.text_of(statement.program)
    store = expressions.store(statement.result) if statement.result else None

    def run(task: Task) -> int:
        caller, code = task.frame, 0.0
        try:
            program = task.control.unused_program(name(task).lower(), task)
            task.enter(program, bind(program.program.parameters, [], program.name))
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


def _return(_: s.Return, at: int) -> Op:
    """Compile RETURN: return to the caller; in the main program it ends the cycle."""

    def run(task: Task) -> int:
        task.leave()
        return at

    return run


def _print(statement: s.Print, at: int) -> Op:
    """Compile PRINT [device:] items and TYPE items; all devices share one output."""
    layout = expressions.layout(statement.items)

    def run(task: Task) -> int:
        text, feed = layout(task)
        task.hardware.print(text, feed=feed)
        return at + 1

    return run


# --- assignments ----------------------------------------------------------------------------------


def _assign(statement: s.Assign, at: int) -> Op:
    """Compile `x = 1`, `$s = "a"`, `@n = 3`."""
    of = expressions.text_of if statement.target.kind == "$" else expressions.number_of
    return _stored(expressions.store(statement.target), of(statement.value), at)


def _point(statement: s.PointStatement, at: int) -> Op:
    """Compile POINT p = pose, POINT #j = pose[,#near], POINT/X p = pose."""
    if statement.target.kind == "#":
        read = _joints(statement)
    elif statement.part:
        read = _part(statement)
    else:
        read = _relative(statement)
    return _stored(expressions.store(statement.target), read, at)


def _here(statement: s.Here, at: int) -> Op:
    """Compile HERE p, HERE #j and HERE a+p: current pose from the encoders."""
    store = expressions.store(statement.target)
    if statement.target.kind == "#":
        return _stored(store, lambda task: task.machine.here_joints(), at)
    relative = expressions.place_of(statement.relative_to) if statement.relative_to else None

    def here(task: Task) -> Transformation:
        place = task.machine.here()
        return compose(inverse(relative(task)), place) if relative else place

    return _stored(store, here, at)


def _decompose(statement: s.Decompose, at: int) -> Op:
    """Compile DECOMPOSE x[k] = pose: six reals from element k on."""
    value = expressions.pose_of(statement.value)
    store = expressions.store_row(statement.target)
    return _stored(store, lambda task: value(task).numbers(), at)


def _stored(store: Callable[[Task, Any], None], value: Callable[[Task], Any], at: int) -> Op:
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


def _relative(statement: s.PointStatement) -> Callable[[Task], Transformation]:
    """Return the pose of a POINT, relative to the rest of a compound target if it has one."""
    value = expressions.place_of(statement.value)
    if statement.relative_to is None:
        return value
    rest = expressions.place_of(statement.relative_to)
    return lambda task: compose(inverse(rest(task)), value(task))


def _part(statement: s.PointStatement) -> Callable[[Task], Value]:
    """Return the target with components of a pose; an undefined target starts from zero."""
    value, old = _relative(statement), expressions.place_of(statement.target)

    def read(task: Task) -> Transformation:
        if statement.part not in POINT_PARTS:
            raise AsError("E0111", f"POINT/{statement.part}")
        source = value(task)
        try:
            before = old(task)
        except AsError:
            before = Transformation()
        return before._replace(**{name: getattr(source, name) for name in statement.part.lower()})

    return read


_STATEMENTS: Mapping[type, Callable[..., Op]] = {
    s.Comment: _no_effect,
    s.Do: _no_effect,
    s.Else: _leave_branch,
    s.Value: _leave_branch,
    s.Any: _leave_branch,
    s.If: _test,
    s.While: _test,
    s.Until: _test,
    s.For: _for,
    s.End: _end,
    s.CaseStatement: _case,
    s.Goto: _goto,
    s.Return: _return,
    s.Assign: _assign,
    s.PointStatement: _point,
    s.Here: _here,
    s.Decompose: _decompose,
    s.CallStatement: _call,
    s.Scall: _scall,
    s.Print: _print,
}

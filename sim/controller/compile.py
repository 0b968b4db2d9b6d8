"""Compiler from programs to closures, with the dispatch table of instructions."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

from sim.as_language import syntax as s
from sim.as_language.errors import AsError
from sim.as_language.expressions import Expressions
from sim.as_language.syntax import Instruction, Program, ProgramStep, SourceFile
from sim.controller import execute_flow as flow
from sim.controller import execute_motion as motion
from sim.controller import execute_output as output
from sim.controller import execute_poses as poses
from sim.controller import execute_settings as settings
from sim.controller import execute_tasks as tasks
from sim.controller import execute_tcp as tcp
from sim.controller import execute_waits as waits
from sim.controller.compiled import Compiled, Op
from sim.controller.evaluate import ArgumentCompiler

if TYPE_CHECKING:
    from sim.controller.task import Task

CompileInstruction = Callable[[Instruction, int, ArgumentCompiler], Op]

_FLOW: dict[type, Callable[..., Op]] = {
    s.If: flow.compile_if,
    s.While: flow.compile_while,
    s.Until: flow.compile_until,
    s.For: flow.compile_for,
    s.End: flow.compile_end,
    s.CaseStatement: flow.compile_case,
    s.Goto: flow.compile_goto,
    s.Return: flow.compile_return,
}
_STATEMENTS: dict[type, Callable[..., Op]] = {
    s.Assign: poses.compile_assign,
    s.PointStatement: poses.compile_point,
    s.Here: poses.compile_here,
    s.Decompose: poses.compile_decompose,
    s.CallStatement: tasks.compile_call,
    s.Scall: tasks.compile_scall,
    s.Print: output.compile_print,
}

INSTRUCTIONS: dict[str, CompileInstruction] = {
    **dict.fromkeys(("LMOVE", "JMOVE", "HMOVE"), motion.compile_move),
    **dict.fromkeys(("LAPPRO", "JAPPRO"), motion.compile_approach),
    **dict.fromkeys(("LDEPART", "JDEPART"), motion.compile_depart),
    "HOME": motion.compile_home,
    "DRIVE": motion.compile_drive,
    **dict.fromkeys(("DRAW", "TDRAW"), motion.compile_draw),
    **dict.fromkeys(("DELAY", "STABLE"), motion.compile_pause),
    "SPEED": settings.compile_speed,
    "ACCURACY": settings.compile_accuracy,
    **dict.fromkeys(("ACCEL", "DECEL"), settings.compile_ramp),
    "BREAK": settings.compile_break,
    "BRAKE": settings.compile_brake,
    "MVWAIT": settings.compile_mvwait,
    **dict.fromkeys(("BASE", "TOOL"), settings.compile_frame),
    "WEIGHT": settings.compile_weight,
    **dict.fromkeys(
        ("LEFTY", "RIGHTY", "ABOVE", "BELOW", "UWRIST", "DWRIST"), settings.compile_posture
    ),
    "WAIT": waits.compile_wait,
    "TWAIT": waits.compile_twait,
    "SWAIT": waits.compile_swait,
    "SIGNAL": waits.compile_signal,
    "PULSE": waits.compile_pulse,
    "BITS": waits.compile_bits,
    "RESET": waits.compile_reset,
    "TIMER": waits.compile_timer,
    "SWITCH": waits.compile_switch,
    "ONE": tasks.compile_one,
    "RETURNE": tasks.compile_returne,
    "HALT": tasks.compile_halt,
    "STOP": tasks.compile_stop,
    "PAUSE": tasks.compile_pause,
    "LOCK": tasks.compile_lock,
    "PCEXECUTE": tasks.compile_pcexecute,
    **dict.fromkeys(("PCABORT", "PCEND", "PCKILL"), tasks.compile_pcabort),
    "PCSCAN": tasks.compile_pcscan,
    **dict.fromkeys(
        ("MC EXECUTE", "MC ABORT", "MC HOLD", "MC CONTINUE", "MC ERESET", "MC SPEED"),
        tasks.compile_mc,
    ),
    **dict.fromkeys(("TCP_LISTEN", "TCP_END_LISTEN"), tcp.compile_listen),
    "TCP_ACCEPT": tcp.compile_accept,
    "TCP_CONNECT": tcp.compile_connect,
    "TCP_SEND": tcp.compile_send,
    "TCP_RECV": tcp.compile_receive,
    "TCP_CLOSE": tcp.compile_close,
}


@lru_cache(maxsize=8)
def compile_file(source: SourceFile) -> Mapping[str, Compiled]:
    """Return the compiled programs of a file; all machines share them."""
    evaluate = ArgumentCompiler(Expressions())
    return {name: compile_program(p, evaluate) for name, p in source.programs.items()}


def compile_program(program: Program, evaluate: ArgumentCompiler) -> Compiled:
    """Return a program that can be executed.

    A step that cannot be compiled does not reject the file: it fails when it is reached, as on the
    controller, with its code, program and step. Steps are compiled lazily when first reached, as
    half of a program never is.
    """
    ops: list[Op] = []
    for at, step in enumerate(program.steps):
        ops.append(_when_reached(step, at, evaluate, ops))
    return Compiled(program, ops)


def _when_reached(step: ProgramStep, at: int, evaluate: ArgumentCompiler, ops: list[Op]) -> Op:
    """Return an operation that compiles itself at the first call and then replaces itself."""
    op: Op | None = None

    def run(task: "Task") -> int:
        nonlocal op
        if op is None:
            op = ops[at] = _compile(step, at, evaluate)
        return op(task)

    return run


def _compile(step: ProgramStep, at: int, evaluate: ArgumentCompiler) -> Op:
    statement = step.statement
    try:
        if isinstance(statement, s.Comment | s.Do):
            return flow.jump_to(at + 1)
        if isinstance(statement, s.Else | s.Value | s.Any):
            return flow.jump_to(statement.end_at)
        compile_flow = _FLOW.get(type(statement))
        if compile_flow is not None:
            return compile_flow(statement, at, evaluate)
        if isinstance(statement, Instruction):
            return _compile_instruction(statement, at, evaluate)
        return _STATEMENTS[type(statement)](statement, at, evaluate)
    except AsError as error:
        return _failing(error)


def _compile_instruction(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    compiler = INSTRUCTIONS.get(statement.name)
    if compiler is None:
        known = "unknown" if statement.unknown else "not emulated"
        return _failing(AsError("E0111", f"{statement.name} is {known}"))
    return compiler(statement, at, evaluate)


def _failing(error: AsError) -> Op:
    def run(_: object) -> int:
        raise AsError(error.code, error.detail)

    return run

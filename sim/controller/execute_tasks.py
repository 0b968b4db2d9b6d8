"""Program tasks: CALL, ONE, HALT, PAUSE, STOP, PCEXECUTE and related, and MC monitor commands."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from sim.as_language import syntax as s
from sim.as_language.errors import AsError
from sim.as_language.syntax import Instruction, Word
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler
from sim.controller.speeds import checked, percent
from sim.controller.task import FOREVER, PC_PROGRAMS, StackFrame, Task

if TYPE_CHECKING:
    from sim.controller.machine import Machine


def compile_call(statement: s.CallStatement, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile CALL prog(arguments)."""
    bind = evaluate.arguments(statement.arguments)
    name = statement.program

    def run(task: Task) -> int:
        machine = task.machine
        program = machine.program(name)
        machine.refuse_if_in_use(program, task)
        task.enter(StackFrame(program, bind(task, program.program)))
        return at + 1

    return run


def compile_scall(statement: s.Scall, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile SCALL $name[,result]: with a result, an error code is stored instead of raised."""
    name = evaluate.text(statement.program)
    store = evaluate.store(statement.result) if statement.result else None
    bind = evaluate.arguments(())

    def run(task: Task) -> int:
        machine, code = task.machine, 0.0
        try:
            program = machine.program(name(task).lower())
            machine.refuse_if_in_use(program, task)
            task.enter(StackFrame(program, bind(task, program.program)))
        except AsError as error:
            if store is None:
                raise
            code = float(error.number)
        if store is not None:
            caller = task.frames[-2:][0] if code == 0.0 else task.frame
            store_in(store, task, caller, code)
        return at + 1

    return run


def store_in(
    store: Callable[[Task, float], None], task: Task, frame: StackFrame, value: float
) -> None:
    """Store a value in the scope of a frame that is not the top of the stack."""
    frames = task.frames
    task.frames = [frame]
    try:
        store(task, value)
    finally:
        task.frames = frames


def compile_one(statement: Instruction, at: int, _: ArgumentCompiler) -> Op:
    """Compile ONE prog: error handler called when a step fails."""
    name = _program(statement, 0)

    def run(task: Task) -> int:
        task.handler = task.machine.program(name).name
        return at + 1

    return run


def compile_returne(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile RETURNE: return from the error handler to the step after the failed one."""

    def run(task: Task) -> int:
        if len(task.frames) < 2 or task.frame.handles is None:
            raise AsError("P0111", "RETURNE outside of a program that ONE called")
        task.leave()
        task.frame.pc += 1
        return at

    return run


def compile_halt(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile HALT: end the program regardless of remaining cycles, after its last motion."""
    return _at_rest(at, lambda task: task.machine.end(task))


def compile_stop(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile STOP: end this cycle; the main program restarts if cycles remain."""
    return _at_rest(at, lambda task: task.machine.end_cycle(task))


def compile_pause(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile PAUSE: hold the program; CONTINUE resumes at the next step."""

    def run(task: Task) -> int:
        robot = task.machine.robot
        if not (task.is_robot and robot.moving):
            task.set_state("held")
            return at + 1

        def condition(_: int) -> bool:
            if robot.moving:
                return False
            task.end_wait()
            task.set_state("held")
            return False

        task.wait(condition)
        return at + 1

    return run


def compile_lock(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile LOCK p: checked, but without effect: there is only one robot program."""
    value = evaluate.argument(statement, 0)

    def run(task: Task) -> int:
        checked(value(task), 0, 127, "LOCK")
        return at + 1

    return run


def compile_pcexecute(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile PCEXECUTE n: prog[,cycles[,step]]."""
    number, cycles, step = (evaluate.argument(statement, k, 1.0) for k in (0, 2, 3))
    name = _program(statement, 1)

    def run(task: Task) -> int:
        task.machine.start_pc(
            _pc_number(number(task)),
            name,
            cycles=_cycles(cycles(task)),
            step=int(checked(step(task), 1, 1e6, "step")),
        )
        return at + 1

    return run


def compile_pcabort(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile PCABORT n: and PCKILL n: (at once), PCEND n: (at the end of the cycle)."""
    number = evaluate.argument(statement, 0, 1.0)
    at_once = statement.name != "PCEND"

    def run(task: Task) -> int:
        task.machine.stop_pc(_pc_number(number(task)), at_once=at_once)
        return at + 1

    return run


def compile_pcscan(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile PCSCAN s: minimum cycle time of this program."""
    period_s = evaluate.argument(statement, 0)

    def run(task: Task) -> int:
        task.scan_s = checked(period_s(task), 0.0, 3600.0, "PCSCAN")
        return at + 1

    return run


def compile_mc(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile MC EXECUTE, ABORT, HOLD, CONTINUE, ERESET, SPEED: in PC programs only."""
    command = statement.name.removeprefix("MC ")
    simple: dict[str, Callable[[Machine], None]] = {
        "ABORT": lambda machine: machine.abort(),
        "HOLD": lambda machine: machine.hold(),
        "CONTINUE": lambda machine: machine.resume(),
        "ERESET": lambda machine: machine.reset_error(),
    }
    act: Callable[[Task], None]
    if command == "EXECUTE":
        name, cycles = _program(statement, 0), evaluate.argument(statement, 1, 1.0)

        def act(task: Task) -> None:
            task.machine.execute(name, cycles=_cycles(cycles(task)))

    elif command == "SPEED":
        speed = evaluate.argument(statement, 0)

        def act(task: Task) -> None:
            task.machine.set_monitor_speed(percent(speed(task), "MC SPEED"))

    else:

        def act(task: Task) -> None:
            simple[command](task.machine)

    def run(task: Task) -> int:
        if task.is_robot:
            raise AsError("P0111", "MC is only allowed in PC programs")
        act(task)
        return at + 1

    return run


def _at_rest(at: int, end: Callable[[Task], None]) -> Op:
    """End a program; the robot program waits for its motion first."""

    def run(task: Task) -> int:
        robot = task.machine.robot
        if not (task.is_robot and robot.moving):
            end(task)
            return at

        def condition(_: int) -> bool:
            if robot.moving:
                return False
            end(task)
            return False

        task.wait(condition)
        return at

    return run


def _program(statement: Instruction, index: int) -> str:
    argument = statement.arguments[index] if index < len(statement.arguments) else None
    if not isinstance(argument, Word):
        raise AsError("P0100", f"{statement.name} needs the name of a program")
    return argument.name


def _cycles(value: float) -> int:
    return FOREVER if value < 0 else int(checked(value, 1, 32767, "cycles"))


def _pc_number(value: float) -> int:
    return PC_PROGRAMS.start - 1 + int(checked(value, 1, len(PC_PROGRAMS), "PC program number"))

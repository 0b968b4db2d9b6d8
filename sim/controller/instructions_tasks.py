"""Instructions for tasks and time: PCEXECUTE, MC, HALT, ONE, WAIT, TIMER, PROMPT, switches."""

from collections.abc import Callable
from functools import partial

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.functions import DECIMAL, value_of
from sim.as_language.values import Value
from sim.controller.hardware import TIMERS
from sim.controller.instruction import Action, at_rest, until
from sim.controller.motion_requests import checked, percent
from sim.controller.tasks import FOREVER, PC_PROGRAMS, Task, TaskControl, Wait

_LONGEST_S = 1e6

# --- tasks ----------------------------------------------------------------------------------------


def one(task: Task, name: str) -> None:
    """ONE prog: error handler called when a step fails."""
    task.handler = task.control.program(name).name


def returne(task: Task) -> None:
    """RETURNE: return from the error handler to the step after the failed one."""
    if len(task.frames) < 2 or task.frame.handles is None:
        raise AsError("P0111", "RETURNE outside of a program that ONE called")
    task.leave()
    task.frame.pc += 1


def end(of: Callable[[Task], None], task: Task) -> Wait | None:
    """HALT, STOP and PAUSE: end the program, its cycle, or hold it, after its last motion."""
    if not task.is_robot:
        of(task)
        return None
    return at_rest(task, of)


def hold(task: Task) -> None:
    """PAUSE: hold the program; CONTINUE resumes at the next step."""
    task.end_wait()
    task.set_state("held")


def pcexecute(task: Task, number: float, name: str, cycles: float = 1.0, step: float = 1.0) -> None:
    """PCEXECUTE n: prog[,cycles[,step]]."""
    task.control.start_pc(
        _pc_number(number), name, cycles=_cycles(cycles), step=int(checked(step, 1, 1e6, "step"))
    )


def pcabort(task: Task, number: float) -> None:
    """PCABORT n: and PCKILL n: (at once). No error if the program does not run."""
    task.control.tasks[_pc_number(number)].set_state("idle")


def pcend(task: Task, number: float) -> None:
    """PCEND n: (at the end of the cycle)."""
    task.control.tasks[_pc_number(number)].cycles = 1


def pcscan(task: Task, period_s: float) -> None:
    """PCSCAN s: minimum cycle time of this program."""
    task.scan_s = checked(period_s, 0.0, 3600.0, "PCSCAN")


def mc(command: Callable[[TaskControl], None], task: Task) -> None:
    """MC ABORT, HOLD, CONTINUE, ERESET."""
    command(task.control)


def mc_execute(task: Task, name: str, cycles: float = 1.0) -> None:
    """MC EXECUTE prog[,cycles]."""
    task.control.execute(name, cycles=_cycles(cycles))


def mc_prime(task: Task, name: str, cycles: float = 1.0) -> None:
    """MC PRIME prog[,cycles]: MC CONTINUE starts it."""
    task.control.prime(name, cycles=_cycles(cycles))


def mc_zpower(task: Task, on: float) -> None:
    """MC ZPOWER ON and OFF: the motors."""
    task.control.motor_power(on=on != 0.0)


def mc_speed(task: Task, value: float) -> None:
    """MC SPEED %: the monitor speed."""
    task.hardware.robot.queue.monitor_fraction = percent(value, "MC SPEED") / 100.0


def _cycles(value: float) -> int:
    return FOREVER if value < 0 else int(checked(value, 1, 32767, "cycles"))


def _pc_number(value: float) -> int:
    return int(checked(value, 1, len(PC_PROGRAMS), "PC program number"))


# --- waits, timers, switches ----------------------------------------------------------------------


def wait(task: Task, condition: Callable[[Task], float]) -> Wait | None:
    """WAIT condition."""
    return until(lambda _: condition(task) != 0.0)


def twait(task: Task, duration_s: float) -> Wait:
    """TWAIT s."""
    wait_s = checked(duration_s, 0.0, _LONGEST_S, "TWAIT")
    end_ns = task.hardware.now_ns + round(wait_s * NS_PER_S)
    return lambda now_ns: now_ns >= end_ns


def timer(task: Task, number: float, value_s: float) -> None:
    """TIMER n = s."""
    number = int(checked(number, 1, TIMERS[-1], "the number of TIMER"))
    task.hardware.set_timer(number, value_s)


def utimer(task: Task, store: Callable[[Task, float], None], value_s: float) -> None:
    """UTIMER @t = s: the variable holds the time [ms] since power-on at which UTIMER(@t) was 0."""
    store(task, task.hardware.uptime_ms - round(checked(value_s, 0.0, 2**31 - 1, "UTIMER") * 1e3))


def prompt(
    task: Task, text: str, *variables: tuple[str, Callable[[Task, Value], None]]
) -> Wait | None:
    """PROMPT "text",x,..: print the text, wait for a line of the keyboard, store it.

    A string variable takes the line; others take its numbers, 0 where there is none. Raises AsError
    E4012 without a keyboard, P0100 for a line that is not of numbers.
    """
    hardware = task.hardware
    if hardware.keyboard is None:
        raise AsError("E4012")
    hardware.print(f"{text}>", feed=True)

    def reads(_: int) -> bool:
        if not hardware.keyboard:
            return False
        line = hardware.keyboard.popleft()
        words = iter(line.replace(",", " ").split())
        for kind, store in variables:
            store(task, line if kind == "$" else _number_in(next(words, "0")))
        return True

    return until(reads)


def panel(task: Task, window: float, *values: object) -> None:
    """IFPWPRINT and IFPWOVERWRITE w,row,column,..="text",..: reported, there is no panel."""
    lines = (value for value in values if isinstance(value, str))
    task.hardware.print_line(f"panel, window {int(window)}: {' | '.join(lines)}")


def _number_in(word: str) -> float:
    """Return a number that was typed. Raises AsError P0100."""
    if not (DECIMAL.fullmatch(word) or word[:2].upper() in ("^H", "^B")):
        raise AsError("P0100", f"PROMPT: {word!a} is not a number")
    return value_of(word)


def switch(task: Task, words: tuple[str, ...], *names: str) -> None:
    """`name,.. ON` and `name,.. OFF`."""
    switches = task.hardware.switches
    for name in names:
        if name not in switches:
            raise AsError("P0111", f"the switch {name.upper()} cannot be set by a program")
    switches.update(dict.fromkeys(names, "ON" in words))


_OfPc = partial(Action, only="pc")

INSTRUCTIONS = {
    "ONE": Action(one, "w"),
    "RETURNE": Action(returne),
    "HALT": Action(partial(end, Task.end)),
    "STOP": Action(partial(end, Task.end_cycle)),
    "PAUSE": Action(partial(end, hold)),
    "PCEXECUTE": Action(pcexecute, "rwrr"),
    "PCABORT": Action(pcabort, "r"),
    "PCKILL": Action(pcabort, "r"),
    "PCEND": Action(pcend, "r"),
    "PCSCAN": Action(pcscan, "r"),
    "MC EXECUTE": _OfPc(mc_execute, "wr"),
    "MC ABORT": _OfPc(partial(mc, TaskControl.abort)),
    "MC HOLD": _OfPc(partial(mc, TaskControl.hold)),
    "MC CONTINUE": _OfPc(partial(mc, TaskControl.continue_program)),
    "MC ERESET": _OfPc(partial(mc, TaskControl.reset_error)),
    "MC PRIME": _OfPc(mc_prime, "wr"),
    "MC SPEED": _OfPc(mc_speed, "r"),
    "MC ZPOWER": _OfPc(mc_zpower, "r"),
    "WAIT": Action(wait, "R"),
    "TWAIT": Action(twait, "r", with_signals=True),
    "TIMER": Action(timer, "rr"),
    "UTIMER": Action(utimer, "ir"),
    "PROMPT": Action(prompt, "tk*"),
    "IFPWPRINT": Action(panel, "ry*"),
    "IFPWOVERWRITE": Action(panel, "ry*"),
    "SWITCH": Action(switch, "mw*"),
}

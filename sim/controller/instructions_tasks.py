"""Instructions for tasks, signals and time: PCEXECUTE, MC, HALT, ONE, WAIT, SIGNAL, TIMER."""

from collections.abc import Callable
from functools import partial

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
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


def mc_speed(task: Task, value: float) -> None:
    """MC SPEED %: the monitor speed."""
    task.hardware.robot.queue.monitor_fraction = percent(value, "MC SPEED") / 100.0


def _cycles(value: float) -> int:
    return FOREVER if value < 0 else int(checked(value, 1, 32767, "cycles"))


def _pc_number(value: float) -> int:
    return int(checked(value, 1, len(PC_PROGRAMS), "PC program number"))


# --- waits, signals, timers -----------------------------------------------------------------------


def wait(task: Task, condition: Callable[[Task], float]) -> Wait | None:
    """WAIT condition."""
    return until(lambda _: condition(task) != 0.0)


def twait(task: Task, duration_s: float) -> Wait:
    """TWAIT s."""
    wait_s = checked(duration_s, 0.0, _LONGEST_S, "TWAIT")
    end_ns = task.hardware.now_ns + round(wait_s * NS_PER_S)
    return lambda now_ns: now_ns >= end_ns


def swait(task: Task, *numbers: float) -> Wait | None:
    """SWAIT s1,s2,..: wait until all are in the given state; negative means OFF."""
    signals = task.hardware.signals
    awaited = [signals.existing(number) for number in numbers]
    return until(lambda _: all(signals.holds(signal) for signal in awaited))


def signal(task: Task, *numbers: float) -> None:
    """SIGNAL s1,s2,..: switch on, or off with a negative number."""
    signals = task.hardware.signals
    for number in [signals.settable(number) for number in numbers]:
        signals.set(number)


def pulse(task: Task, number: float, duration_s: float = 0.2) -> None:
    """PULSE s,t: on for t seconds; does not wait."""
    hardware = task.hardware
    on = hardware.signals.settable(number)
    on_s = checked(duration_s, 0.0, 3600.0, "PULSE")
    hardware.signals.pulse(on, hardware.now_ns + round(on_s * NS_PER_S))


def bits(task: Task, first: float, count: float, value: float) -> None:
    """BITS s,n = v: the low n bits of v on signals s, s+1, ..."""
    signals = task.hardware.signals
    for k in range(int(checked(count, 1, 16, "the number of signals in BITS"))):
        number = signals.settable(int(first) + k)
        signals.set(number if int(value) >> k & 1 else -number)


def reset(task: Task) -> None:
    """RESET: switch every output off."""
    task.hardware.signals.reset_outputs()


def timer(task: Task, number: float, value_s: float) -> None:
    """TIMER n = s."""
    number = int(checked(number, 1, TIMERS[-1], "the number of TIMER"))
    task.hardware.set_timer(number, value_s)


def switch(task: Task, name: str, words: tuple[str, ...]) -> None:
    """`name ON` and `name OFF`."""
    if name not in task.hardware.switches:
        raise AsError("P0111", f"the switch {name.upper()} cannot be set by a program")
    task.hardware.switches[name] = "ON" in words


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
    "MC CONTINUE": _OfPc(partial(mc, TaskControl.resume)),
    "MC ERESET": _OfPc(partial(mc, TaskControl.reset_error)),
    "MC SPEED": _OfPc(mc_speed, "r"),
    "WAIT": Action(wait, "R"),
    "TWAIT": Action(twait, "r"),
    "SWAIT": Action(swait, "r*"),
    "SIGNAL": Action(signal, "r*"),
    "PULSE": Action(pulse, "rr"),
    "BITS": Action(bits, "rrr"),
    "RESET": Action(reset),
    "TIMER": Action(timer, "rr"),
    "SWITCH": Action(switch, "wm"),
}

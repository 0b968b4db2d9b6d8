"""Instructions for signals: SIGNAL, SWAIT, PULSE, BITS, SOUT, RUNMASK; interrupts: ON, ONI."""

from functools import partial

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.controller.instruction import Action, until
from sim.controller.interrupts import Interrupt, ignore, monitor
from sim.controller.motion_requests import checked
from sim.controller.tasks import Task, Wait

_LONGEST_S = 3600.0
_PRIORITIES = (1, 127)


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
    on_s = checked(duration_s, 0.0, _LONGEST_S, "PULSE")
    hardware.signals.pulse(on, hardware.now_ns + round(on_s * NS_PER_S))


def dlysig(task: Task, number: float, delay_s: float) -> None:
    """DLYSIG s,t: SIGNAL s after t seconds; does not wait."""
    hardware = task.hardware
    switched = hardware.signals.settable(number)
    due_ns = hardware.now_ns + round(checked(delay_s, 0.0, _LONGEST_S, "DLYSIG") * NS_PER_S)
    hardware.when(lambda: hardware.now_ns >= due_ns, lambda: hardware.signals.set(switched))


def bits(name: str, most: int, task: Task, first: float, count: float, value: float) -> None:
    """BITS s,n = v and BITS32: the low n bits of v on signals s, s+1, ..."""
    signals = task.hardware.signals
    for k in range(int(checked(count, 1, most, f"the number of signals in {name}"))):
        number = signals.settable(int(first) + k)
        signals.set(number if int(value) >> k & 1 else -number)


def sout(task: Task, number: float, state: float) -> None:
    """SOUT s = expression of signals: evaluated once, when the step is executed."""
    switched = task.hardware.signals.settable(number)
    task.hardware.signals.set(abs(switched) if state else -abs(switched))


def reset(task: Task) -> None:
    """RESET: switch every output off."""
    task.hardware.signals.reset_outputs()


def runmask(task: Task, first: float, count: float = 1.0) -> None:
    """RUNMASK s[,n]: the signals are off while the program does not run; negative: no longer."""
    signals = task.hardware.signals
    numbers = [signals.settable(abs(first) + k) for k in range(int(checked(count, 1, 960, "n")))]
    if first > 0:
        task.masked.update(numbers)
    else:
        task.masked.difference_update(numbers)


def on(
    name: str,
    task: Task,
    number: float,
    words: tuple[str, ...],
    target: str,
    priority: float | None = None,
) -> None:
    """ON[/ERR or /LVL] s CALL p[,priority], ON s GOTO label, and ONI.

    Raises AsError E1070 (/ERR) if the signal is there already, E0101, E0105 for its target.
    """
    signals, frame = task.hardware.signals, task.frame
    watched = signals.existing(number)
    is_there = signals.holds(watched)
    if is_there and "/ERR" in words:
        raise AsError("E1070", f"signal {watched}")
    call, goto = "", 0
    if "CALL" in words:
        call = task.control.program(target).name
    elif target in frame.program.program.labels:
        goto = frame.program.program.labels[target]
    else:
        raise AsError("E0101", f"ON ... GOTO {target}")
    rank = int(checked(1.0 if priority is None else priority, *_PRIORITIES, "the priority of ON"))
    before = is_there and "/LVL" not in words
    monitor(Interrupt(task, frame, watched, name == "ONI", rank, call, goto, before))


def ignore_signal(task: Task, number: float) -> None:
    """IGNORE s: end the interrupts of a signal."""
    ignore(task, task.hardware.signals.existing(number))


# Those that wait for the motion before them with PREFETCH.SIGINS OFF: TWAIT is one as well.
_Synchronized = partial(Action, with_signals=True)

INSTRUCTIONS = {
    "SWAIT": _Synchronized(swait, "r*"),
    "SIGNAL": _Synchronized(signal, "r*"),
    "PULSE": _Synchronized(pulse, "rr"),
    "DLYSIG": _Synchronized(dlysig, "rr"),
    "BITS": _Synchronized(partial(bits, "BITS", 16), "rrr"),
    "BITS32": _Synchronized(partial(bits, "BITS32", 32), "rrr"),
    "SOUT": Action(sout, "rs"),
    "RESET": _Synchronized(reset),
    "RUNMASK": _Synchronized(runmask, "rr"),
    "ON": Action(partial(on, "ON"), "rmwn"),
    "ONI": Action(partial(on, "ONI"), "rmwn", only="robot"),
    "IGNORE": Action(ignore_signal, "r"),
}

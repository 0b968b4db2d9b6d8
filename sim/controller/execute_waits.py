"""Waits, timers and signals: WAIT, TWAIT, SWAIT, TIMER, SIGNAL, PULSE, BITS, RESET, switches."""

from collections.abc import Callable

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.syntax import Instruction, Word
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler
from sim.controller.speeds import checked
from sim.controller.task import Task
from sim.controller.timers import TIMERS

_LONGEST_S = 1e6


def compile_wait(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile WAIT condition."""
    condition = evaluate.argument(statement, 0)
    return wait_until(at, lambda task: lambda _: condition(task) != 0.0)


def compile_twait(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TWAIT s."""
    duration_s = evaluate.argument(statement, 0)

    def run(task: Task) -> int:
        wait_s = checked(duration_s(task), 0.0, _LONGEST_S, "TWAIT")
        end_ns = task.machine.now_ns + round(wait_s * NS_PER_S)
        task.wait(lambda now_ns: now_ns >= end_ns)
        return at + 1

    return run


def compile_swait(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile SWAIT s1,s2,..: wait until all are in the given state; negative means OFF."""
    numbers = [evaluate.argument(statement, k) for k in range(len(statement.arguments))]

    def begin(task: Task) -> Callable[[int], bool]:
        machine = task.machine
        signals = [machine.signal_number(number(task)) for number in numbers]
        return lambda _: all(machine.signals.holds(signal) for signal in signals)

    return wait_until(at, begin)


def compile_signal(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile SIGNAL s1,s2,..: switch on, or off with a negative number."""
    numbers = [evaluate.argument(statement, k) for k in range(len(statement.arguments))]

    def run(task: Task) -> int:
        machine = task.machine
        for signal in [machine.settable_signal(number(task)) for number in numbers]:
            machine.signals.set(signal)
        return at + 1

    return run


def compile_pulse(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile PULSE s,t: on for t seconds (0.2 by default); does not wait."""
    number = evaluate.argument(statement, 0)
    duration_s = evaluate.argument(statement, 1, 0.2)

    def run(task: Task) -> int:
        machine = task.machine
        signal = machine.settable_signal(number(task))
        machine.signals.set(signal)
        wait_s = checked(duration_s(task), 0.0, 3600.0, "PULSE")
        machine.later(wait_s, lambda: machine.signals.set(-signal))
        return at + 1

    return run


def compile_bits(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile BITS s,n = v: the low n bits of v on signals s, s+1, ..."""
    first, count, value = (evaluate.argument(statement, k) for k in range(3))

    def run(task: Task) -> int:
        machine = task.machine
        number = int(checked(count(task), 1, 16, "the number of signals in BITS"))
        bits, start = int(value(task)), int(first(task))
        for k in range(number):
            signal = machine.settable_signal(start + k)
            machine.signals.set(signal if bits >> k & 1 else -signal)
        return at + 1

    return run


def compile_reset(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile RESET: switch every output off."""

    def run(task: Task) -> int:
        task.machine.signals.reset_outputs()
        return at + 1

    return run


def compile_timer(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TIMER n = s."""
    number = evaluate.argument(statement, 0)
    value_s = evaluate.argument(statement, 1)

    def run(task: Task) -> int:
        timer = int(checked(number(task), 1, TIMERS[-1], "the number of TIMER"))
        machine = task.machine
        machine.timers.write_s(timer, value_s(task), machine.now_ns)
        return at + 1

    return run


def compile_switch(statement: Instruction, at: int, _: ArgumentCompiler) -> Op:
    """Compile `name ON` and `name OFF`."""
    words = [word.name for word in statement.arguments if isinstance(word, Word)]
    on = "ON" in statement.modifiers

    def run(task: Task) -> int:
        switches = task.machine.switches
        for name in words:
            if switches.is_reported(name) or not switches.exists(name):
                raise AsError("P0111", f"the switch {name.upper()} cannot be set by a program")
            switches.write(name, on=on)
        return at + 1

    return run


def wait_until(at: int, begin: Callable[[Task], Callable[[int], bool]]) -> Op:
    """Return an operation that waits; a condition already true costs one step and no wait."""

    def run(task: Task) -> int:
        holds = begin(task)
        if not holds(0):
            task.wait(holds)
        return at + 1

    return run

"""Signals of the controller: inputs, outputs and internal signals by number."""

from sim.as_language.errors import AsError

OUTPUTS = range(1, 961)
INPUTS = range(1001, 1961)
INTERNAL = range(2001, 2961)


class Signals:
    """Signals of the controller; all are initially OFF. A negative number means OFF."""

    def __init__(self) -> None:
        """Switch everything off."""
        self._on: set[int] = set()
        self._pulses: list[tuple[int, int]] = []  # end [ns] and number of each pulse

    @staticmethod
    def existing(value: float) -> int:
        """Return the number of a signal. Raises AsError E0106."""
        number = int(value)
        if not any(abs(number) in numbers for numbers in (OUTPUTS, INPUTS, INTERNAL)):
            raise AsError("E0106", f"signal {number} does not exist")
        return number

    @classmethod
    def settable(cls, value: float) -> int:
        """Return the number of an output or internal signal. Raises AsError E0106."""
        number = cls.existing(value)
        if abs(number) in INPUTS:
            raise AsError("E0106", f"signal {abs(number)} is an input")
        return number

    def set(self, number: int) -> None:
        """Switch a signal on, or off with a negative number. Also inputs, for tests."""
        if number > 0:
            self._on.add(number)
        else:
            self._on.discard(-number)

    def pulse(self, number: int, end_ns: int) -> None:
        """Switch a signal as its number says until a time [ns], then back."""
        self.set(number)
        self._pulses.append((end_ns, number))

    def holds(self, number: int) -> bool:
        """Return whether a signal is on, or off with a negative number."""
        return (abs(number) in self._on) == (number > 0)

    def reset_outputs(self) -> None:
        """Switch every output off (RESET)."""
        self._on -= set(OUTPUTS)

    def tick(self, now_ns: int) -> None:
        """End the pulses that are due."""
        if self._pulses:
            due = [number for end_ns, number in self._pulses if end_ns <= now_ns]
            self._pulses = [pulse for pulse in self._pulses if pulse[0] > now_ns]
            for number in due:
                self.set(-number)

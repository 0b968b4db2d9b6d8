"""Inputs, outputs and internal signals by number; a negative number means OFF."""

OUTPUTS = range(1, 961)
INPUTS = range(1001, 1961)
INTERNAL = range(2001, 2961)


class Signals:
    """Signals of the controller; all are initially OFF."""

    def __init__(self) -> None:
        """Switch everything off."""
        self._on: set[int] = set()

    @staticmethod
    def exists(number: int) -> bool:
        """Return whether a signal has this number, regardless of sign."""
        return any(abs(number) in numbers for numbers in (OUTPUTS, INPUTS, INTERNAL))

    @staticmethod
    def can_be_set(number: int) -> bool:
        """Return whether a program may set the signal; inputs are external."""
        return abs(number) in OUTPUTS or abs(number) in INTERNAL

    def set(self, number: int) -> None:
        """Switch a signal on, or off with a negative number. Also inputs, for tests."""
        if number > 0:
            self._on.add(number)
        else:
            self._on.discard(-number)

    def holds(self, number: int) -> bool:
        """Return whether a signal is on, or off with a negative number."""
        return (abs(number) in self._on) == (number > 0)

    def reset_outputs(self) -> None:
        """Switch every output off (RESET)."""
        self._on -= set(OUTPUTS)

"""Inputs, outputs and internal signals by number; a negative number means OFF."""

OUTPUTS = range(1, 961)
INPUTS = range(1001, 1961)
INTERNAL = range(2001, 2961)


class Signals:
    """All signals of the controller; every one starts OFF."""

    def __init__(self) -> None:
        """Switch everything off."""
        self._on: set[int] = set()

    @staticmethod
    def exists(number: int) -> bool:
        """Tell whether a signal has this number, whatever its sign."""
        return any(abs(number) in numbers for numbers in (OUTPUTS, INPUTS, INTERNAL))

    @staticmethod
    def can_be_set(number: int) -> bool:
        """Tell whether a program may set the signal: inputs come from outside."""
        return abs(number) in OUTPUTS or abs(number) in INTERNAL

    def set(self, number: int) -> None:
        """Switch a signal on, or off with a negative number. Inputs too: tests wire them."""
        if number > 0:
            self._on.add(number)
        else:
            self._on.discard(-number)

    def holds(self, number: int) -> bool:
        """Tell whether a signal is on, or off with a negative number."""
        return (abs(number) in self._on) == (number > 0)

    def reset_outputs(self) -> None:
        """Switch every output off (RESET)."""
        self._on -= set(OUTPUTS)

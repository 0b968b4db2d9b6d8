"""Digital signals of the simulated robot: outputs as switched, inputs that follow outputs.

`sim.inputs_follow` of the cell file connects an input with an output, as a switch on a gripper is;
other inputs are off until a test sets them.
"""

from collections.abc import Mapping

from common.config.cell import CellConfig
from common.runtime.signal_service import SignalReading
from forcemesh.messages import Trip


def followed_numbers(cell: CellConfig) -> dict[int, int]:
    """Return number of the output by number of the input that follows it."""
    pairs: Mapping[str, str] = {} if cell.sim is None else cell.sim.inputs_follow
    return {
        cell.signals[name].number: cell.signals[output].number for name, output in pairs.items()
    }


class SimSignals:
    """State of the signals that the cell file names, by number; initially all are off."""

    def __init__(self, cell: CellConfig) -> None:
        """Switch everything off."""
        self._on = {signal.number: False for signal in cell.signals.values()}
        self._follows = followed_numbers(cell)

    def switch(self, number: int, on: bool) -> Trip | None:  # noqa: FBT001 - a `Switch`
        """Switch an output, and the inputs that follow it; in tests also an input."""
        self._on[number] = on
        for follower, output in self._follows.items():
            if output == number:
                self._on[follower] = on
        return None

    def reading(self) -> SignalReading:
        """Return the present state, which is always known."""
        return SignalReading(dict(self._on))

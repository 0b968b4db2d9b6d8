"""A cell from Python: `with Cell("cells/demo.yaml") as cell: cell.arm(); cell.force.press(15.0)`.

Every verb waits until it is done, up to a time, and raises an exception of `forcemesh.errors` when
it is not: a refusal with code and remedy, an arm that was stopped, a service that fell silent.
Command line, panel and notebooks use it; it imports neither physics nor plots.
"""

from forcemesh.client.cell import Cell
from forcemesh.client.feed import Feed, Heard
from forcemesh.client.force import Force, Pressed
from forcemesh.client.moves import Move, Moves
from forcemesh.errors import (
    ArmStoppedError,
    BusError,
    ConfigError,
    DataError,
    ForcemeshError,
    LostError,
    NotReachedError,
    NotValidError,
    RefusedError,
)

__all__ = [
    "ArmStoppedError",
    "BusError",
    "Cell",
    "ConfigError",
    "DataError",
    "Feed",
    "Force",
    "ForcemeshError",
    "Heard",
    "LostError",
    "Move",
    "Moves",
    "NotReachedError",
    "NotValidError",
    "Pressed",
    "RefusedError",
]

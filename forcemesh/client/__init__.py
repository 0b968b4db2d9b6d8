"""Python client: `with Cell("cells/demo.yaml") as cell: cell.arm(); cell.force.press(15.0)`.

Every method waits for completion, up to a timeout, and otherwise raises an exception of
`forcemesh.errors`: a refusal with code and remedy, a stopped arm, a silent service.
Command line, panel and notebooks use it; it imports neither physics nor plots.
"""

from forcemesh.client.cell import Cell
from forcemesh.client.contact import ContactEvents
from forcemesh.client.feed import Feed, Received
from forcemesh.client.force import Force, PressResult
from forcemesh.client.moves import Move, Moves
from forcemesh.client.signals import DigitalSignals
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
from forcemesh.force_task import parse_task
from forcemesh.requests import ForceTask, TaskAxis

__all__ = [
    "ArmStoppedError",
    "BusError",
    "Cell",
    "ConfigError",
    "ContactEvents",
    "DataError",
    "DigitalSignals",
    "Feed",
    "Force",
    "ForceTask",
    "ForcemeshError",
    "LostError",
    "Move",
    "Moves",
    "NotReachedError",
    "NotValidError",
    "PressResult",
    "Received",
    "RefusedError",
    "TaskAxis",
    "parse_task",
]

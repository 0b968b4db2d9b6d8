"""forcemesh: a force-controlled cell from Python, and the language of its bus.

    from forcemesh import Cell

    with Cell("tcp/127.0.0.1:7447", "demo") as cell:
        cell.arm()
        cell.force.press(15.0)

What is named here is loaded when it is first used: a process that only needs `forcemesh.topics`
does not load the bus.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from forcemesh.version import __version__

if TYPE_CHECKING:
    from forcemesh.client import (
        ArmStoppedError,
        BusError,
        Cell,
        ConfigError,
        DataError,
        Feed,
        Force,
        ForcemeshError,
        ForceTask,
        LostError,
        Move,
        Moves,
        NotReachedError,
        NotValidError,
        PressResult,
        Received,
        RefusedError,
        TaskAxis,
        parse_task,
    )

__all__ = [
    "ArmStoppedError",
    "BusError",
    "Cell",
    "ConfigError",
    "DataError",
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
    "__version__",
    "parse_task",
]


def __getattr__(name: str) -> object:
    """Load a public name of the client. Raise AttributeError for any other name."""
    if name in __all__:
        return getattr(import_module("forcemesh.client"), name)
    raise AttributeError(f"module 'forcemesh' has no attribute {name!r}")

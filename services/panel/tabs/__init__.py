"""The tabs of the panel: each module here is one. To add one, add a file with `TAB` in it.

`build` fills the tab for one person and may return what refreshes it, called some times a second.
"""

import pkgutil
from collections.abc import Callable
from importlib import import_module
from typing import NamedTuple

import viser

from services.panel.viewer import Viewer
from services.panel.watch import Snapshot

Refresh = Callable[[Snapshot], None]


class Tab(NamedTuple):
    """One tab: where it stands, what it is called, what fills it."""

    order: int
    label: str
    icon: viser.IconName
    build: Callable[[Viewer], Refresh | None]


def all_tabs() -> list[Tab]:
    """Return the tabs of all modules of this folder, in order."""
    names = (module.name for module in pkgutil.iter_modules(__path__))
    found: list[Tab] = [import_module(f"{__name__}.{name}").TAB for name in names]
    return sorted(found, key=lambda tab: tab.order)

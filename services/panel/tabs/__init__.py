"""Tabs of the panel: each module with a `TAB` in this folder is one.

`build` fills the tab for one client and returns its refresh function, called four times a second.
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
    """One tab: its order, label, icon and build function."""

    order: int
    label: str
    icon: viser.IconName
    build: Callable[[Viewer], Refresh]


def all_tabs() -> list[Tab]:
    """Return the tabs of all modules of this folder, sorted by order."""
    names = (module.name for module in pkgutil.iter_modules(__path__))
    found: list[Tab] = [import_module(f"{__name__}.{name}").TAB for name in names]
    return sorted(found, key=lambda tab: tab.order)

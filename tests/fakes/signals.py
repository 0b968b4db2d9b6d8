"""A cell with signals: outputs with each kind of permission, and an input."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import pytest

from cli.context import one_line_errors
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from tests.fakes.bench import DEMO, HALF_RATES
from tests.fakes.lab import Lab

NAMED: dict[str, dict[str, Any]] = {
    "gripper_close": {"output": 9, "set_by": ["operator", "program"]},
    "lamp": {"output": 10, "set_by": ["operator"], "while_held": True},
    "motor": {"output": 11},  # reported only
    "part": {"input": 1001},
}
ALL_OFF = dict.fromkeys(NAMED, False)
FOLLOWING = {"signals": NAMED, "sim.inputs_follow": {"part": "lamp"}}


@contextmanager
def armed_with_signals(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType
) -> Iterator[ConfiguredCell]:
    """Give the verbs of a module an armed cell with signals, in virtual time."""
    lab = Lab(load_cell(DEMO, {**FOLLOWING, "rates": HALF_RATES}))
    client = ConfiguredCell(lab.cell.cell, bus=lab.cell.client, commander="operator")

    @contextmanager
    def connected(_named: Any) -> Iterator[ConfiguredCell]:
        with one_line_errors():
            yield client

    monkeypatch.setattr(module, "cell_of", connected)
    yield client
    client.close()

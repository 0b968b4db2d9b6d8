"""A gateway's start and end: it starts with a whole configuration, and the arm holds at its end."""

from typing import Any

import numpy as np
import pytest

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from controller.packet_table import Scales
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.errors import ConfigError
from services.gateway.service import Gateway
from tests.contract.rig import gateway_cell, pose_goal, shifted
from tests.contract.robots import Both
from tests.fakes.bench import CELL
from tests.fakes.controller import PORT
from tests.fakes.dialogues import scale_ends
from tests.fakes.gateway_cell import a_cell


def gateway(cell: CellConfig) -> Gateway:
    """Return the gateway of a cell; its socket is opened in the first step."""
    return Gateway(Bus("robot", cell.cell, MemoryTransport(), cell, ManualClock()), cell)


def test_a_gateway_without_its_section_reports_what_is_missing() -> None:
    """A simulated cell has no such section, and this process can be started by hand."""
    assert CELL.gateway is None
    with pytest.raises(ConfigError) as caught:
        gateway(CELL)
    assert caught.value.mistakes == ["gateway: the section is missing"]


@pytest.mark.parametrize("name", Scales.model_fields)
@pytest.mark.parametrize("end", ["lowest", "highest"])
def test_a_scale_that_cannot_represent_the_limits_is_refused(name: str, end: str) -> None:
    """The ends of its range are accepted; the next values are refused with the cell file."""
    low, high = scale_ends(name)
    good, bad = (low, low - 1) if end == "lowest" else (high, high + 1)
    good_cell: dict[str, Any] = {f"gateway.{name}": good}
    assert gateway(gateway_cell(PORT, **good_cell)).verdict.command is None
    with pytest.raises(ConfigError) as caught:
        gateway_cell(PORT, **{f"gateway.{name}": bad})
    (line,) = caught.value.mistakes
    assert name in line


def test_the_controller_holds_when_its_gateway_ends() -> None:
    """In the middle of a move the line is closed, and the arm stops short of its goal."""
    cell = a_cell()
    rig, both = cell.rig, cell.rig.service
    assert isinstance(both, Both)
    rig.connect()
    rig.arm()
    start = rig.T
    rig.send("goal", goal=pose_goal(1, shifted(start, z_m=0.1)))
    rig.until(lambda: rig.T.translation[2] > start.translation[2] + 0.01)
    both.gateway.close()
    track: list[np.ndarray] = []
    for _ in range(1000):
        rig.clock.sleep_s(0.001)
        cell.controller.live(rig.clock.now_ns() / 1e9)
        track.append(cell.controller.T_base_flange.translation)
    assert np.ptp(track[500:], axis=0).max() < 1e-6
    assert track[-1][2] < start.translation[2] + 0.05

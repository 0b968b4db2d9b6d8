"""`cell.signals` on a whole cell in virtual time: simulated, and with the program over TCP."""

from collections.abc import Iterator

import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.client import DataError, NotValidError, RefusedError
from services.gateway.service import Gateway
from tests.fakes.bench import DEMO, HALF_RATES
from tests.fakes.lab import Lab
from tests.fakes.signals import FOLLOWING

CELLS = {
    "sim": load_cell(DEMO, {**FOLLOWING, "rates": HALF_RATES}),
    "tcp": load_cell(DEMO.with_name("demo-tcp.yaml"), FOLLOWING),
}


@pytest.fixture(params=CELLS)
def lab(request: pytest.FixtureRequest) -> Lab:
    """An armed cell with signals; `part` follows `lamp`."""
    return Lab(CELLS[request.param])


@pytest.fixture
def cell(lab: Lab) -> Iterator[ConfiguredCell]:
    """An operator on it."""
    with ConfiguredCell(lab.cell.cell, bus=lab.cell.client, commander="operator") as client:
        yield client


def test_while_the_arm_holds_only_what_may_be_is_set(lab: Lab, cell: ConfiguredCell) -> None:
    """And outputs stay as they are when the arm is held."""
    cell.signals.set("gripper_close")
    cell.signals.wait("gripper_close", timeout_s=2.0)
    cell.hold("a test")
    lab.cell.advance(0.3)
    with pytest.raises(RefusedError, match="not set while the robot holds") as refused:
        cell.signals.set("gripper_close", False)
    assert refused.value.code == "signal_held"
    cell.signals.set("lamp")
    cell.signals.wait("lamp", timeout_s=2.0)
    assert cell.signals.read()["gripper_close"]


def test_what_the_cell_file_does_not_permit_is_refused(lab: Lab, cell: ConfiguredCell) -> None:
    """Another commander, an input, an output that is only reported, one that is not named."""
    with ConfiguredCell(lab.cell.cell, bus=lab.cell.client, commander="program") as program:
        program.signals.set("gripper_close")
        with pytest.raises(RefusedError, match="may be set by operator, not by program"):
            program.signals.set("lamp")
    for signal, code in (
        ("part", "signal_not_permitted"), ("motor", "signal_not_permitted"),
        (12, "signal_unknown"), ("", "signal_unknown"),
    ):  # fmt: skip
        with pytest.raises(RefusedError) as refused:
            cell.signals.set(signal)
        assert refused.value.code == code
    with pytest.raises(DataError, match="signal"):
        cell.signals.set("a" * 41)


def test_a_lost_link_is_no_state() -> None:
    """Over TCP: not valid at once, refused, neither on nor off; known again after reconnection."""
    lab = Lab(CELLS["tcp"])
    with ConfiguredCell(lab.cell.cell, bus=lab.cell.client, commander="operator") as cell:
        cell.signals.set("lamp")
        cell.signals.wait("lamp", timeout_s=2.0)
        gateway = lab.cell.runners["robot"].service
        assert isinstance(gateway, Gateway)
        gateway.close()
        lab.cell.advance(0.02)
        reading = cell.signals.feed.reading()
        assert reading.message is not None
        assert (reading.message.valid, reading.message.on) == (False, {})
        with pytest.raises(NotValidError):
            cell.signals.read(0.01)
        with pytest.raises(RefusedError) as refused:
            cell.signals.set("lamp")
        assert refused.value.code == "robot_link"
        lab.cell.advance(5.0)
        assert cell.signals.read()["lamp"]  # the controller keeps its outputs

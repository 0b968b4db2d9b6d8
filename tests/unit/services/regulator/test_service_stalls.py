"""A link that stalls one way winds nothing up: no peak, no lift-off, or held in contact."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest
from launch import virtual_cell as virtual
from launch.virtual_cell import VirtualCell
from tests.fakes.long import long
from tests.fakes.stalling_wire import StallingWire

CELLS = Path(__file__).parents[4] / "cells"
SETPOINT_N = 20.0
MOST_N = 1.3 * SETPOINT_N
LEAST_N = 1.0  # of contact: the tool has not lifted off
GAP_M = 0.002


class Stalled:
    """A cell with gateway and emulated controller that presses over a wire that stalls."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, host: Any, law: Any) -> None:
        """Tare, arm, press."""
        monkeypatch.setattr(virtual, "LockStepLink", StallingWire)
        cell = load_cell(CELLS / "demo-tcp.yaml", {"sim.gap_m": GAP_M})
        self.cell = VirtualCell(cell)
        self.status = self.cell.client.reader(topics.ARBITER_STATUS)
        self.cell.advance(1.5)
        assert self.cell.client.ask(topics.TARE, Empty()).accepted
        assert self.cell.client.ask(topics.ARM, ArmRequest()).accepted
        wanted = ForceStartRequest(mode="position", host=host, law=law, setpoint_N=SETPOINT_N)
        assert self.cell.client.ask(topics.FORCE_START, wanted).accepted

    def force_N(self) -> float:
        """How hard the plate truly pushes."""
        return float(np.linalg.norm(self.cell.arm.true_wrench().force_N))

    def stall(self, direction: str, seconds: float) -> None:
        """Let one direction stall from now on."""
        until_ns = self.cell.clock.now_ns() + round(seconds * NS_PER_S)
        setattr(StallingWire.newest, f"{direction}_until_ns", until_ns)

    def watch(self, seconds: float) -> tuple[float, float]:
        """Return the least and the largest force of some time."""
        forces = []
        for _ in range(round(seconds * 1e3)):
            self.cell.advance(0.001)
            forces.append(self.force_N())
        return min(forces), max(forces)

    @property
    def held(self) -> bool:
        """Whether the arbiter holds."""
        status = self.status.read(self.cell.clock.now_ns()).message
        return status is not None and status.state in {"HOLDING", "FAULT"}


@pytest.mark.parametrize("stall_ms", [long(50), long(120), 200, long(240)])
@pytest.mark.parametrize("direction", ["out", "in"])
@pytest.mark.parametrize(
    ("host", "law"), [("pc", "plain"), ("pc", "adaptive"), ("controller", "plain")]
)
def test_a_stall_at_first_touch_makes_no_peak(
    monkeypatch, host: Any, law: Any, direction: str, stall_ms: int
) -> None:
    """It begins as the tool touches: what was wanted meanwhile is not pressed into the plate."""
    press = Stalled(monkeypatch, host, law)
    press.cell.advance(3.0, lambda: press.force_N() > 0.5)
    press.stall(direction, stall_ms / 1e3)
    _, most_N = press.watch(stall_ms / 1e3 + 0.5)
    assert most_N <= MOST_N
    least_N, most_N = press.watch(0.5)
    assert least_N >= LEAST_N
    assert most_N <= MOST_N
    if not press.held:
        press.cell.advance(1.0)
        assert press.force_N() == pytest.approx(SETPOINT_N, abs=1.0)


@pytest.mark.parametrize("stall_ms", [long(50), long(120), 200, long(240)])
@pytest.mark.parametrize("direction", ["out", "in"])
@pytest.mark.parametrize(
    ("host", "law"), [("pc", "plain"), ("pc", "adaptive"), ("controller", "plain")]
)
def test_a_stall_while_holding_neither_presses_nor_lifts(
    monkeypatch, host: Any, law: Any, direction: str, stall_ms: int
) -> None:
    """The set point falls to half of it just before: the error is there for the whole stall."""
    press = Stalled(monkeypatch, host, law)
    press.cell.advance(3.0, lambda: press.force_N() > 0.98 * SETPOINT_N)
    press.cell.advance(0.3)
    wanted = ForceStartRequest(mode="position", host=host, law=law, setpoint_N=SETPOINT_N / 2)
    assert press.cell.client.ask(topics.FORCE_START, wanted).accepted
    press.stall(direction, stall_ms / 1e3)
    least_N, most_N = press.watch(stall_ms / 1e3 + 1.0)
    assert least_N >= LEAST_N
    assert most_N <= MOST_N

"""A link that stalls in one direction: no wind-up, no peak, no lift-off, or a hold in contact."""

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
MAX_N = 1.3 * SETPOINT_N
MIN_N = 1.0  # contact force of a tool that has not lifted off
GAP_M = 0.002


class Stalled:
    """A cell with gateway and emulated controller that presses over a stalling wire."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, host: Any, law: Any) -> None:
        """Tare, arm, press."""
        monkeypatch.setattr(virtual, "LockStepLink", StallingWire)
        cell = load_cell(CELLS / "demo-tcp.yaml", {"sim.gap_m": GAP_M})
        self.cell = VirtualCell(cell)
        self.status = self.cell.client.reader(topics.ARBITER_STATUS)
        self.cell.advance(1.5)
        assert self.cell.client.ask(topics.TARE, Empty()).accepted
        assert self.cell.client.ask(topics.ARM, ArmRequest()).accepted
        request = ForceStartRequest(mode="position", host=host, law=law, setpoint_N=SETPOINT_N)
        assert self.cell.client.ask(topics.FORCE_START, request).accepted

    def force_N(self) -> float:
        """Return the true contact force of the plate."""
        return float(np.linalg.norm(self.cell.arm.true_wrench().force_N))

    def stall(self, direction: str, seconds: float) -> None:
        """Let one direction stall from now on."""
        until_ns = self.cell.clock.now_ns() + round(seconds * NS_PER_S)
        setattr(StallingWire.newest, f"{direction}_until_ns", until_ns)

    def watch(self, seconds: float) -> tuple[float, float]:
        """Return the least and the largest force of an interval."""
        forces = []
        for _ in range(round(seconds * 1e3)):
            self.cell.advance(0.001)
            forces.append(self.force_N())
        return min(forces), max(forces)

    @property
    def held(self) -> bool:
        """Return whether the arbiter holds."""
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
    """The stall begins at the touch: motion proposed meanwhile is not pressed into the plate."""
    press = Stalled(monkeypatch, host, law)
    press.cell.advance(3.0, lambda: press.force_N() > 0.5)
    press.stall(direction, stall_ms / 1e3)
    _, largest_N = press.watch(stall_ms / 1e3 + 0.5)
    assert largest_N <= MAX_N
    smallest_N, largest_N = press.watch(0.5)
    assert smallest_N >= MIN_N
    assert largest_N <= MAX_N
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
    """The set point is halved just before: the error is present for the whole stall."""
    press = Stalled(monkeypatch, host, law)
    press.cell.advance(3.0, lambda: press.force_N() > 0.98 * SETPOINT_N)
    press.cell.advance(0.3)
    request = ForceStartRequest(mode="position", host=host, law=law, setpoint_N=SETPOINT_N / 2)
    assert press.cell.client.ask(topics.FORCE_START, request).accepted
    press.stall(direction, stall_ms / 1e3)
    smallest_N, largest_N = press.watch(stall_ms / 1e3 + 1.0)
    assert smallest_N >= MIN_N
    assert largest_N <= MAX_N

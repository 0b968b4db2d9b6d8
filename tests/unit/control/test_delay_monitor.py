"""Watch of the loop delay: its estimate from motion and link, and the share of the gains. Pure."""

from collections import deque
from math import inf, nextafter
from typing import Any

import numpy as np
import pytest

from common.config.load import load_cell
from control.delay_monitor import LINK_S, DelayMonitor, DelayMonitorSettings
from control.gain_rule import tune
from forcemesh import topics
from forcemesh.messages import ArbiterStatus, LinkHealth
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest
from services.regulator.service import Regulator
from tests.fakes.bench import CELL, DEMO, cell_with
from tests.fakes.regulator_bench import RegulatorBench
from tests.unit.services.regulator.conftest import Press

SETTINGS = DelayMonitorSettings.of(CELL)
DT_S = 0.004


def test_the_rise_of_the_links_round_trip_counts_when_it_is_the_larger_one() -> None:
    """Its level at the start is part of the model; only what is added since then is excess."""
    watch = DelayMonitor()
    for trip_s in (None, 0.004, None):
        watch.follow_link(trip_s, DT_S)
    assert (watch.trip_s, watch.excess_now_s) == (0.004, 0.0)
    for _ in range(round(4.0 * LINK_S / DT_S)):
        watch.follow_link(0.034, DT_S)
    assert watch.excess_now_s == pytest.approx(0.03, abs=0.001)
    watch.excess_s = 0.05
    assert watch.excess_now_s == 0.05
    watch.excess_s = 0.0
    for _ in range(round(8.0 * LINK_S / DT_S)):
        watch.follow_link(0.002, DT_S)
    assert watch.excess_now_s == pytest.approx(0.0, abs=1e-5)


def test_within_the_tolerance_the_gains_are_whole() -> None:
    """The tolerance itself is within; beyond, the share is tau over the estimated delay."""
    tau_s, tolerance_s = SETTINGS.tau_s, SETTINGS.tolerance_s
    assert SETTINGS.share_for(-0.01) == SETTINGS.share_for(tolerance_s) == 1.0
    beyond_s = nextafter(tolerance_s, inf)
    assert SETTINGS.share_for(beyond_s) == tau_s / (tau_s + beyond_s)
    assert SETTINGS.share_for(tau_s) == pytest.approx(0.5)


def test_the_share_falls_at_once_and_rises_slowly_to_exactly_one() -> None:
    """Without steps; full gains multiply nothing."""
    watch = DelayMonitor(excess_s=SETTINGS.tau_s)
    shares = []
    for _ in range(50):
        watch.ramp(DT_S, SETTINGS)
        shares.append(watch.share)
    assert shares[0] > 0.9
    assert shares[24] == pytest.approx(0.5, abs=0.02)  # 0.1 s
    assert shares[-1] == 0.5
    watch.excess_s, before = 0.0, watch.share
    for _ in range(round(0.5 / DT_S)):
        watch.ramp(DT_S, SETTINGS)
        assert 0.0 < watch.share - before < 0.005
        before = watch.share
    assert watch.share < 0.85
    for _ in range(round(8.0 / DT_S)):
        watch.ramp(DT_S, SETTINGS)
    assert watch.share == 1.0


# --- in a whole cell ----------------------------------------------------------------------------

TCP_CELL = load_cell(DEMO.with_name("demo-tcp.yaml"))
SETPOINT_N, SECOND_SETPOINT_N = 20.0, 30.0
STIFFNESS_N_M = 5e4
LONGER_BY_MS = 30
GAINS_OF_PLAIN = 3.0  # times the rule: it is stable at the modelled delay, and rings at the longer


class LaterLine:
    """Set-point line of a simulated arm behind a further dead time."""

    def __init__(self, line: Any, delay_ms: int) -> None:
        """Put it in front of a line; the command stands until the first one has passed."""
        self._line, self._delay_ms, self._waiting = line, delay_ms, deque[np.ndarray]()
        self.settled = False  # the servos always follow

    def push(self, command: np.ndarray) -> np.ndarray:
        """Take this tick's command; return this tick's servo set point."""
        self._waiting.append(np.array(command))
        first = self._waiting[0]
        if len(self._waiting) > self._delay_ms:
            first = self._waiting.popleft()
        out: np.ndarray = self._line.push(first)
        return out


def stiff_press(law: str, **changes: Any) -> Press:
    """Return a cell that presses on a stiff plate."""
    settings = {
        "sim__stiffness_N_m": STIFFNESS_N_M, "contact__stiffness_N_m": STIFFNESS_N_M,
        "sim__gap_m": 0.0005, "robot__delay_s": 0.01, "sim__delay_s": 0.01,
        "limits__force_N": 400.0, "force__approach_m_s": 0.004, "force__law": law,
    }  # fmt: skip
    return Press(cell_with(**settings | changes), SETPOINT_N)


def ripple_N(forces_N: np.ndarray) -> float:
    """Return the peak-to-peak force."""
    return float(np.ptp(forces_N))


@pytest.mark.parametrize("law", ["plain", "adaptive"])
@pytest.mark.parametrize("is_watched", [True, False])
def test_a_delay_that_grows_from_10_to_40_ms_lowers_the_gains_before_the_force_oscillates(
    monkeypatch: pytest.MonkeyPatch, law: str, is_watched: bool
) -> None:
    """With whole gains the same cell oscillates, so this test can fail."""
    press = stiff_press(law)
    if law == "plain":
        gain = GAINS_OF_PLAIN * tune(press.cell.cell).force_i_m_per_Ns
        request = GainsRequest(force_i_m_per_Ns=(gain, gain, gain))
        assert press.ask(topics.GAINS, request).accepted
    if not is_watched:
        monkeypatch.setattr(DelayMonitor, "ramp", lambda *_: None)
    assert ripple_N(press.forces_N(1.2)[-200:]) < 1.0
    assert press.published.gain_share == 1.0
    arm: Any = press.cell.arm
    arm._line = LaterLine(arm._line, LONGER_BY_MS)  # a fault of the arm
    press.start(SECOND_SETPOINT_N)
    forces_N = press.forces_N(1.5)
    if not is_watched:
        assert ripple_N(forces_N[-500:]) > 10.0
        return
    assert ripple_N(forces_N[-500:]) < 1.0
    assert forces_N[-1] == pytest.approx(SECOND_SETPOINT_N, abs=0.6)
    target, tau_s = press.published, press.cell.cell.plant.tau_s
    assert target.valid
    assert target.modelled_round_trip_s == tau_s
    assert target.round_trip_s == pytest.approx(tau_s + 0.03, abs=0.004)
    assert target.gain_share == pytest.approx(tau_s / (tau_s + 0.03), abs=0.05)
    service: Any = press.cell.runners["regulator"].service
    assert service.numbers(0)["loop_delay_s"] == target.round_trip_s


def test_an_oscillation_lowers_the_gains_and_the_press_goes_on() -> None:
    """The plate is four times stiffer than the cell file says: half the gains are enough."""
    stiff = 2e4 * 0.45 / 1.75  # k Ki tau = 1.75, just beyond pi / 2
    press = stiff_press(
        "plain", sim__stiffness_N_m=2e4, contact__stiffness_N_m=stiff, force__lost_m=0.05,
        force__approach_m_s=0.001,
    )  # fmt: skip
    forces_N = press.forces_N(5.0)
    target = press.published
    assert target.valid
    assert target.gain_share in (0.5, 0.25)
    assert forces_N[-1] == pytest.approx(SETPOINT_N, abs=0.6)
    press.start(SECOND_SETPOINT_N)  # the lowered gains stay
    assert ripple_N(press.forces_N(1.5)[-200:]) < 1.0
    assert press.published.gain_share == target.gain_share
    press.ask(topics.FORCE_STOP, Empty())
    press.start(SETPOINT_N)
    press.cell.advance(0.1)
    assert press.published.gain_share == 1.0  # until the session ends


# --- on the controller ----------------------------------------------------------------------------


def controlled(law: str = "plain") -> RegulatorBench:
    """Return a regulator whose loop the controller runs, with a link of 4 ms."""
    bench = RegulatorBench(TCP_CELL)
    bench.robot = bench.robot.replaced(link=LinkHealth(connected=True, round_trip_s=0.004))
    bench.pass_s(0.1)
    request = ForceStartRequest(mode="position", host="controller", law=law)
    assert bench.start(request).accepted
    bench.arbiter = ArbiterStatus(state="ACTIVE", commander="regulator", lease=3)
    bench.pass_s(0.2)
    return bench


def sent_share(bench: RegulatorBench) -> float:
    """Return the sent integral gain over the rule's."""
    feedback = bench.published().feedback
    assert feedback is not None
    return feedback.gains.force_i_m_per_Ns[2] / tune(TCP_CELL).force_i_m_per_Ns


def numbers_of(bench: RegulatorBench) -> dict[str, float]:
    """Return the numbers of its health message."""
    assert isinstance(bench.service, Regulator)
    return bench.service.numbers(0)


def test_a_slower_link_lowers_the_gains_of_the_controller_in_steps() -> None:
    """Its own motion is not judged; the round trip of the link says how late its forces are."""
    bench, shares = controlled(), []
    assert sent_share(bench) == 1.0
    bench.robot = bench.robot.replaced(link=LinkHealth(connected=True, round_trip_s=0.04))
    for _ in range(500):
        bench.step()
        shares.append(sent_share(bench))
    tau_s = TCP_CELL.plant.tau_s
    assert bench.published().gain_share == pytest.approx(tau_s / (tau_s + 0.036), abs=0.01)
    assert bench.published().gain_share == pytest.approx(shares[-1], rel=0.15)  # of what is sent
    assert 2 <= len(set(shares)) <= 6
    bench.robot = bench.robot.replaced(link=LinkHealth(connected=True, round_trip_s=0.004))
    bench.pass_s(12.0)
    assert sent_share(bench) == bench.published().gain_share == 1.0


def test_the_health_has_the_delay_of_the_last_session() -> None:
    """Without any session there is none; after one it stays."""
    bench = RegulatorBench()
    assert numbers_of(bench) == {}
    bench = controlled()
    during = numbers_of(bench)
    assert during == {"loop_delay_model_s": TCP_CELL.plant.tau_s, "gain_fraction": 1.0}
    bench.ask(topics.FORCE_STOP, Empty())
    assert numbers_of(bench) == during

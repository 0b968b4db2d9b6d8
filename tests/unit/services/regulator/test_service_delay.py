"""The regulator while the delay of its loop grows, and while the force oscillates."""

from collections import deque
from typing import Any

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import ArbiterStatus, LinkHealth, RegulatorTarget
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, GainsRequest, Reply
from launch.virtual_cell import VirtualCell
from services.regulator.delay_watch import DelayWatch
from services.regulator.service import Regulator
from tests.fakes.bench import DEMO, cell_with
from tests.fakes.regulator_bench import RegulatorBench
from tuning.gain_rule import tune

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


class StiffPress:
    """A virtual cell that presses on a stiff plate."""

    def __init__(self, law: str, **changes: Any) -> None:
        """Press until the force is at its set point."""
        settings = {
            "sim__stiffness_N_m": STIFFNESS_N_M, "contact__stiffness_N_m": STIFFNESS_N_M,
            "sim__gap_m": 0.0005, "robot__delay_s": 0.01, "sim__delay_s": 0.01,
            "limits__force_N": 400.0, "force__approach_m_s": 0.004, "force__law": law,
        }  # fmt: skip
        self.cell = VirtualCell(cell_with(**settings | changes))
        self._target = self.cell.client.reader(topics.REGULATOR_TARGET)
        self.cell.advance(1.3)
        assert self.ask(topics.TARE, Empty()).accepted
        assert self.ask(topics.ARM, ArmRequest()).accepted
        self.press(SETPOINT_N)

    def ask(self, topic: Any, request: Any) -> Reply:
        """Send a request."""
        return self.cell.client.ask(topic, request)

    def press(self, setpoint_N: float) -> None:
        """Start with a set point, or change it."""
        request = ForceStartRequest(mode="position", setpoint_N=setpoint_N)
        assert self.ask(topics.FORCE_START, request).accepted

    @property
    def target(self) -> RegulatorTarget:
        """Newest target of the regulator."""
        target = self._target.read(self.cell.clock.now_ns()).message
        assert target is not None
        return target

    def forces_N(self, duration_s: float) -> np.ndarray:
        """Let time pass; return the true contact force of each period."""
        forces = []
        for _ in range(round(duration_s / 0.004)):
            self.cell.advance(0.004)
            forces.append(float(np.linalg.norm(self.cell.arm.true_wrench().force_N)))
        return np.array(forces)

    def grow_delay(self) -> None:
        """Put a further dead time between the arm and its commands."""
        arm: Any = self.cell.arm
        arm._line = LaterLine(arm._line, LONGER_BY_MS)  # a fault of the arm


def ripple_N(forces_N: np.ndarray) -> float:
    """Return the peak-to-peak force."""
    return float(np.ptp(forces_N))


@pytest.mark.parametrize("law", ["plain", "adaptive"])
@pytest.mark.parametrize("is_watched", [True, False])
def test_a_delay_that_grows_from_10_to_40_ms_lowers_the_gains_before_the_force_oscillates(
    monkeypatch: pytest.MonkeyPatch, law: str, is_watched: bool
) -> None:
    """With whole gains the same cell oscillates, so this test can fail."""
    press = StiffPress(law)
    if law == "plain":
        gain = GAINS_OF_PLAIN * tune(press.cell.cell).force_i_m_per_Ns
        request = GainsRequest(force_i_m_per_Ns=(gain, gain, gain))
        assert press.ask(topics.GAINS, request).accepted
    if not is_watched:
        monkeypatch.setattr(DelayWatch, "ramp", lambda *_: None)
    assert ripple_N(press.forces_N(1.2)[-50:]) < 1.0
    assert press.target.gain_share == 1.0
    press.grow_delay()
    press.press(SECOND_SETPOINT_N)
    forces_N = press.forces_N(1.5)
    if not is_watched:
        assert ripple_N(forces_N[-125:]) > 10.0
        return
    assert ripple_N(forces_N[-125:]) < 1.0
    assert forces_N[-1] == pytest.approx(SECOND_SETPOINT_N, abs=0.6)
    target, tau_s = press.target, press.cell.cell.loop_delay_s
    assert target.valid
    assert target.modelled_round_trip_s == tau_s
    assert target.round_trip_s == pytest.approx(tau_s + 0.03, abs=0.004)
    assert target.gain_share == pytest.approx(tau_s / (tau_s + 0.03), abs=0.05)


def test_an_oscillation_lowers_the_gains_and_the_press_goes_on() -> None:
    """The plate is four times stiffer than the cell file says: half the gains are enough."""
    stiff = 2e4 * 0.45 / 1.75  # k Ki tau = 1.75, just beyond pi / 2
    press = StiffPress(
        "plain", sim__stiffness_N_m=2e4, contact__stiffness_N_m=stiff, force__lost_m=0.05,
        force__approach_m_s=0.001,
    )  # fmt: skip
    forces_N = press.forces_N(5.0)
    target = press.target
    assert target.valid
    assert target.gain_share in (0.5, 0.25)
    assert forces_N[-1] == pytest.approx(SETPOINT_N, abs=0.6)
    press.press(SECOND_SETPOINT_N)  # the lowered gains stay
    assert ripple_N(press.forces_N(1.5)[-50:]) < 1.0
    assert press.target.gain_share == target.gain_share
    press.ask(topics.FORCE_STOP, Empty())
    press.press(SETPOINT_N)
    press.cell.advance(0.1)
    assert press.target.gain_share == 1.0  # until the session ends


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
    tau_s = TCP_CELL.loop_delay_s
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
    assert during == {"loop_delay_model_s": TCP_CELL.loop_delay_s, "gain_fraction": 1.0}
    bench.ask(topics.FORCE_STOP, Empty())
    assert numbers_of(bench) == during

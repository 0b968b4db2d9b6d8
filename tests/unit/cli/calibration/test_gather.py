"""Reading at rest: stillness of pose and reading, each sample once, what is lost is read again."""

from typing import Any

import numpy as np
import pytest

from cli.calibration.gather import STILL_WITHIN_S, Gatherer
from common.bus.memory_bus import MemoryTransport
from common.motion.frames import rotation_from_vector
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.messages import RobotState, SensorWrench, WrenchAtTcp
from identification.dwells import dwells_of_purpose, means_of, recording_of, samples_of, save_dwells
from identification.errors import CalibrationError
from identification.excitation.stillness import PoseSample, StillnessDetector
from identification.recording import read_recording
from tests.fakes.calibration import demo_cell

CELL = demo_cell()
NOISE_N = 0.1


class LivelyClock(ManualClock):
    """To sleep is to let sensor and robot speak: the sensor each 2 ms, the robot each 4 ms."""

    def __init__(self) -> None:
        """Begin at rest, 10 N on the sensor."""
        super().__init__()
        self.transport = MemoryTransport()
        self._made = {
            topic.key: Bus(topic.writer, CELL.cell, self.transport, CELL, self).publisher(topic)
            for topic in (topics.SENSOR_WRENCH, topics.ROBOT_STATE, topics.WRENCH)
        }
        self._rng = np.random.default_rng(0)
        self.force_N: Any = lambda t_s: 10.0
        self.x_m: Any = lambda t_s: 0.4
        self.fault: Any = lambda t_s: ""
        self.said: list[float] = []  # z force of every good reading

    @property
    def t_s(self) -> float:
        """Time since the start [s]."""
        return (self.now_ns() - NS_PER_S) / NS_PER_S

    def sleep_s(self, duration_s: float) -> None:
        """Move on by whole milliseconds, with everybody speaking."""
        for _ in range(max(1, round(1e3 * duration_s))):
            self.advance_ns(1_000_000)
            tick = self.now_ns() // 1_000_000
            if tick % 4 == 0:
                state = RobotState(position_m=(self.x_m(self.t_s), 0.0, 0.3))
                self._made["robot/state"].put(state)
                self._made["wrench"].put(WrenchAtTcp(force_N=(0.3, 0.0, 0.0), calibration="abc"))
            if tick % 2 == 0:
                self._speak()

    def _speak(self) -> None:
        fault = self.fault(self.t_s)
        if fault:
            message = SensorWrench(valid=False, reason=fault, code="sensor_fault", status="fault")
        else:
            z_N = self.force_N(self.t_s) + NOISE_N * float(self._rng.normal())
            self.said.append(z_N)
            message = SensorWrench(force_N=(0.0, 0.0, z_N), serial="FT1234")
        self._made["sensor/wrench"].put(message)


@pytest.fixture
def clock() -> LivelyClock:
    """A clock on which sensor and robot speak."""
    return LivelyClock()


@pytest.fixture
def gatherer(clock) -> Gatherer:
    """A client of that cell, which has heard something."""
    found = Gatherer(Bus(topics.CLIENT, CELL.cell, clock.transport, CELL, clock), CELL)
    found.until_received()
    return found


def no_watch(_what: str) -> None:
    """Nobody watches."""


def test_a_dwell_holds_each_good_reading_once(clock, gatherer):
    """As many rows as the sensor said in that time, the very numbers, none twice."""
    dwell = gatherer.dwell("fit", 0.5, no_watch)
    assert len(dwell) == 250
    heard = clock.said[-len(dwell) - 1 :]
    assert set(np.round(dwell.force_N[:, 2], 12)) <= set(np.round(heard, 12))
    assert (np.diff(dwell.time_s) > 0.0).all()
    assert dwell.time_s[-1] - dwell.time_s[0] == pytest.approx(0.498)
    assert gatherer.serial == "FT1234"
    T_sensor = CELL.sensor.T_flange_sensor.pose
    assert dwell.attitude == pytest.approx(np.array(T_sensor.rotation))
    assert dwell.position_m[0] == pytest.approx([0.4, 0.0, 0.32])


def test_what_the_cell_leaves_is_taken_about_the_sensor(gatherer):
    """A force of 0.3 N at the TCP, 140 mm away, is 42 mN m about the sensor's origin."""
    dwell = gatherer.dwell("verify", 0.3, no_watch)
    assert dwell.residual_N == pytest.approx([0.3, 0.0, 0.0])
    assert np.linalg.norm(dwell.residual_Nm) == pytest.approx(0.3 * 0.14)
    assert gatherer.active_calibration == "abc"


def test_it_waits_until_arm_and_force_are_still(clock, gatherer):
    """The dwell begins when the motion has ended and the force has settled, not before."""
    clock.x_m = lambda t_s: 0.4 + 0.05 * max(0.0, 1.0 - t_s)
    clock.force_N = lambda t_s: 10.0 + 5.0 * np.exp(-max(0.0, t_s - 1.0) / 0.3)
    waits: list[str] = []
    dwell = gatherer.dwell("fit", 0.3, waits.append)
    assert dwell.time_s[0] > 1.4
    assert dwell.force_N[:, 2].mean() == pytest.approx(10.0, abs=0.5)
    assert any("the arm to rest" in text for text in waits)
    assert any("a steady force" in text for text in waits)
    assert waits[-1] == "reading"


@pytest.mark.parametrize(
    ("what", "says"),
    [("x_m", "still waiting for the arm to rest"), ("force_N", "waiting for a steady force")],
)
def test_what_never_rests_ends_with_what_was_waited_for(clock, gatherer, what, says):
    """Ten seconds, then one sentence that names it."""
    began_s = clock.t_s
    setattr(clock, what, lambda t_s: 0.4 + 0.8 * t_s)
    with pytest.raises(CalibrationError, match=says):
        gatherer.dwell("fit", 0.3, no_watch)
    assert clock.t_s - began_s == pytest.approx(STILL_WITHIN_S, abs=0.2)


def test_a_fault_while_reading_is_read_again(clock, gatherer):
    """A short fault costs one dwell; nothing of the spoilt one is kept."""
    clock.fault = lambda t_s: "a spike" if 0.6 <= t_s < 0.65 else ""
    dwell = gatherer.dwell("fit", 0.3, no_watch)
    assert dwell.time_s[0] > 0.65
    assert len(dwell) == 150


def test_a_second_fault_is_an_error_with_the_sensor_s_own_words(clock, gatherer):
    """It is not tried for ever."""
    clock.fault = lambda t_s: "a loose plug" if t_s % 0.5 > 0.45 else ""
    with pytest.raises(CalibrationError, match=r"failed twice: .*a loose plug"):
        gatherer.dwell("fit", 1.0, no_watch)


def test_an_arm_that_moves_while_reading_is_read_again(clock, gatherer):
    """A push against the arm in the middle of a dwell spoils it."""
    clock.x_m = lambda t_s: 0.4 if t_s < 0.7 else 0.402
    dwell = gatherer.dwell("fit", 0.5, no_watch)
    assert np.ptp(dwell.position_m, axis=0).max() == 0.0
    assert dwell.position_m[0, 0] == pytest.approx(0.402)


def test_a_silent_sensor_is_named(clock):
    """Without any reading there is nothing to wait for."""
    clock.fault = lambda t_s: "no power"
    gatherer = Gatherer(Bus(topics.CLIENT, CELL.cell, clock.transport, CELL, clock), CELL)
    with pytest.raises(CalibrationError, match=r"no reading within 2 s: .*no power"):
        gatherer.until_received()


def test_stillness_allows_for_the_noise_of_the_sensor():
    """A noisy sensor at rest is still; the same change without noise is not."""

    def judged(noise_N: float, change_N: float) -> str:
        rng, stillness = np.random.default_rng(1), StillnessDetector()
        for k in range(400):
            reading = noise_N * rng.normal(size=6) * [1, 1, 1, 0.05, 0.05, 0.05]
            reading[0] += change_N * (k >= 300)
            stillness.add(PoseSample(k * 2_000_000, np.zeros(3), np.eye(3), reading))
        return stillness.pending_condition()

    assert judged(3.0, 0.0) == ""
    assert judged(3.0, 0.1) == ""
    assert "steady force (it changed by 0.10 N)" in judged(0.001, 0.1)


def test_a_turning_sensor_is_not_still():
    """The flange may rest while the wrist turns."""
    stillness = StillnessDetector()
    for k in range(300):
        R = rotation_from_vector(np.array([0.0, 0.0, 1e-5 * k]))
        stillness.add(PoseSample(k * 2_000_000, np.zeros(3), R, np.zeros(6)))
    assert "0.11 degrees" in stillness.pending_condition()
    stillness.clear()
    assert stillness.pending_condition() == "readings"
    assert stillness.newest is None


def test_what_was_recorded_comes_back_from_its_file(gatherer, tmp_path):
    """`payload fit` reads the file; rows to fit come first, with the lines that are shown."""
    dwells = [gatherer.dwell(purpose, 0.2, no_watch) for purpose in ("verify", "fit", "fit")]
    path = tmp_path / "new" / "cell.csv"
    save_dwells(dwells, path)
    back, fit = read_recording(path), dwells_of_purpose(dwells, "fit")
    recording = recording_of(fit, path)
    count = len(recording.line)
    assert count == 200
    assert back.line[:count] == recording.line
    assert back.time_s[:count] == pytest.approx(recording.time_s)
    assert back.force_N[:count] == pytest.approx(recording.force_N, abs=1e-7)
    assert back.R_base_sensor[:count] == pytest.approx(recording.R_base_sensor, abs=1e-7)
    assert back.position_m[:count] == pytest.approx(recording.position_m)
    assert len(back.line) == 300
    assert len(samples_of(fit)) == 200
    assert means_of(fit).force_N[:, 2] == pytest.approx([10.0, 10.0], abs=0.05)

"""The wrench service on the bus: what it publishes, when it says "not valid", and tare."""

import numpy as np
import pinocchio as pin
import pytest

from common import topics
from common.convert import record_of
from common.frames import GRAVITY_M_S2, Oat, R_from_oat, rotation_from_vector
from common.messages import Empty, RobotState, RobotStatus, SensorWrench, WrenchAtTcp
from services.wrench.service import WrenchService
from tests.fakes.bench import CELL, Bench

SENSOR_S = 1.0 / CELL.rates.sensor_hz
DOWN = R_from_oat(Oat(0.0, np.pi, 0.0))
BIAS_N, BIAS_NM = np.array(CELL.payload.bias_force_N), np.array(CELL.payload.bias_torque_Nm)
MASS_KG, COM_M = CELL.payload.mass_kg, np.array(CELL.payload.com_m)
P_FLANGE_TCP = np.array(CELL.tool.T_flange_tcp.position_m)
P_FLANGE_SENSOR = np.array(CELL.sensor.T_flange_sensor.position_m)
R_FLANGE_SENSOR = CELL.sensor.T_flange_sensor.pose.rotation


class WrenchBench(Bench):
    """The service between a robot and a sensor that tests may silence or bend."""

    def __init__(self) -> None:
        """Start with a tool that hangs free, pointing down."""
        super().__init__("wrench", WrenchService, step_s=SENSOR_S)
        self.R_base_flange, self.p_m = DOWN, np.array([0.0, 0.5, 0.35])
        self.force_N, self.torque_Nm = np.zeros(3), np.zeros(3)  # environment, base, at the TCP
        self.status = RobotStatus()
        self.sensor: dict[str, object] = {}  # fields to say instead of the truth
        self.silent: set[str] = set()
        self.before_step = self._speak
        self.out = self.watch(topics.WRENCH)

    def _speak(self) -> None:
        if "robot" not in self.silent:
            pose = record_of(pin.SE3(self.R_base_flange, self.p_m))
            self.put(
                topics.ROBOT_STATE,
                RobotState.model_validate(
                    {
                        **pose.model_dump(),
                        "status": self.status,
                        "valid": "robot!" not in self.silent,
                    }
                ),
            )
        if "sensor" not in self.silent:
            self.put(topics.SENSOR_WRENCH, self.sample())

    def sample(self) -> SensorWrench:
        """Return the ideal reading: weight, environment and bias, in sensor axes."""
        R = self.R_base_flange @ R_FLANGE_SENSOR
        weight_N = np.array([0.0, 0.0, -MASS_KG * GRAVITY_M_S2])
        lever_m = self.R_base_flange @ (P_FLANGE_TCP - P_FLANGE_SENSOR)
        moment_Nm = np.cross(R @ COM_M, weight_N) + np.cross(lever_m, self.force_N) + self.torque_Nm
        truth = {
            "force_N": tuple((R.T @ (weight_N + self.force_N) + BIAS_N).tolist()),
            "torque_Nm": tuple((R.T @ moment_Nm + BIAS_NM).tolist()),
        }
        return SensorWrench.model_validate(truth | self.sensor)

    def said(self) -> WrenchAtTcp:
        """Return the newest wrench."""
        message: WrenchAtTcp = self.newest(topics.WRENCH)
        return message

    def settle(self) -> WrenchAtTcp:
        """Let the filter settle."""
        self.pass_s(0.1)
        return self.said()


@pytest.fixture
def bench() -> WrenchBench:
    """A service that has heard nothing yet."""
    return WrenchBench()


# --- what is published ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "turn", [(0, 0, 0), (0.5, 0, 0), (0, -1.2, 0.3), (1.0, 1.0, 2.0), (3, 0, 0)]
)
def test_the_wrench_is_the_environments_at_the_tcp_in_base(bench: WrenchBench, turn) -> None:
    """In any orientation: free it is zero, pushed it is the push, the raw reading beside it."""
    bench.R_base_flange = rotation_from_vector(np.array(turn, dtype=float)) @ DOWN
    free = bench.settle()
    assert free.valid
    assert free.force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert free.torque_Nm == pytest.approx((0, 0, 0), abs=1e-9)

    bench.force_N, bench.torque_Nm = np.array([3.0, -4.0, 30.0]), np.array([0.1, 0.2, -0.3])
    pushed = bench.settle()
    assert pushed.force_N == pytest.approx((3.0, -4.0, 30.0), abs=1e-5)
    assert pushed.torque_Nm == pytest.approx((0.1, 0.2, -0.3), abs=1e-5)
    assert pushed.raw_force_N == bench.sample().force_N
    assert pushed.raw_torque_Nm == bench.sample().torque_Nm


def test_it_publishes_at_the_control_rate_with_the_sample_behind_it(bench: WrenchBench) -> None:
    """Every second sample at 500 and 250 Hz; the origin is that sample's stamp and number."""
    bench.settle()
    before = bench.out.counters
    first = before.received + before.superseded
    for _ in range(500):
        bench.step()
        reading = bench.out.read(bench.clock.now_ns())
        origin = reading.origin
        assert origin is not None
        assert 0 <= bench.clock.now_ns() - origin.stamp_ns <= 2 * SENSOR_S * 1e9
    told = bench.out.counters.received + bench.out.counters.superseded - first
    assert told == pytest.approx(CELL.rates.control_hz * 500 * SENSOR_S, abs=2)


# --- not valid ------------------------------------------------------------------------------------


def test_before_the_first_sample_it_says_what_is_missing(bench: WrenchBench) -> None:
    """An idle service and a dead one must not look alike."""
    bench.silent = {"sensor", "robot"}
    bench.step()
    assert (bench.said().valid, bench.said().reason) == (False, "sensor/wrench missing")


@pytest.mark.parametrize(
    ("name", "topic"), [("sensor", topics.SENSOR_WRENCH), ("robot", topics.ROBOT_STATE)]
)
def test_a_stale_input_is_told_by_name_and_at_the_usual_rate(
    bench: WrenchBench, name, topic
) -> None:
    """Valid up to the deadline, then not valid with age and limit, every period."""
    bench.settle()
    bench.silent = {name}
    bench.pass_s(CELL.stale_after_s(topic) - 2 * SENSOR_S)
    assert bench.said().valid
    bench.step(4)
    first = bench.out.counters.received + bench.out.counters.superseded
    bench.pass_s(1.0)
    message = bench.said()
    assert not message.valid
    assert message.reason.startswith(f"{topic.key} stale: ")
    assert bench.service.fault == message.reason
    told = bench.out.counters.received + bench.out.counters.superseded - first
    assert told == pytest.approx(CELL.rates.control_hz, rel=0.4)

    bench.silent = set()
    assert bench.settle().valid
    assert bench.service.fault == ""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"status": "saturated"}, "the sensor says saturated"),
        ({"status": "fault"}, "the sensor says fault"),
        ({"valid": False, "reason": "no cable"}, "sensor/wrench invalid: no cable"),
        ({"force_N": (0.0, 0.0, 501.0)}, "beyond its range"),
        ({"force_N": (1.7e308,) * 3}, "beyond its range"),
        ({"torque_Nm": (0.0, -20.1, 0.0)}, "beyond its range"),
    ],
)
def test_a_sample_that_is_no_measurement_makes_no_wrench(
    bench: WrenchBench, changes, reason
) -> None:
    """Not valid with the reason, and once it is over no trace of it is left in the filter."""
    bench.settle()
    bench.sensor = {"force_N": (400.0, 400.0, 400.0), **changes}
    bench.step(4)
    assert not bench.said().valid
    assert reason in bench.said().reason
    assert bench.said().force_N == (0.0, 0.0, 0.0)

    bench.sensor = {}
    for _ in range(20):
        bench.step()
        if bench.said().valid:
            assert bench.said().force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert bench.said().valid


def test_a_robot_without_an_orientation_makes_no_wrench(bench: WrenchBench) -> None:
    """A quaternion of zeros is said with its name; the service goes on."""
    bench.settle()
    bench.silent = {"robot"}
    bench.put(topics.ROBOT_STATE, RobotState(orientation_xyzw=(0.0, 0.0, 0.0, 0.0)))
    bench.step(2)
    assert not bench.said().valid
    assert "robot/state" in bench.said().reason


def test_after_a_gap_the_filter_starts_anew(bench: WrenchBench) -> None:
    """The first wrench after silence is of the present, not a mean with the past."""
    bench.force_N = np.array([0.0, 0.0, 40.0])
    bench.settle()
    bench.silent = {"sensor"}
    bench.pass_s(0.3)
    bench.silent, bench.force_N = set(), np.zeros(3)
    for _ in range(6):
        bench.step()
        if bench.said().valid:
            assert bench.said().force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert bench.said().valid


def test_a_sample_counts_once_however_often_the_service_steps(bench: WrenchBench) -> None:
    """Between two samples the output stands still: time is the sensor's, not the loop's."""
    bench.settle()
    bench.force_N = np.array([0.0, 0.0, 40.0])
    bench.step(4)
    bench.silent = {"sensor"}
    bench.step(3)
    before = bench.said().force_N[2]
    assert 1.0 < before < 39.0
    bench.step(10)
    assert bench.said().force_N[2] == before


# --- tare -----------------------------------------------------------------------------------------


def test_tare_at_rest_makes_the_reading_zero_and_says_so(bench: WrenchBench) -> None:
    """A drift of the sensor is taken out here and in another orientation; nothing else changes."""
    drifted = np.array(bench.sample().force_N) + np.array([2.0, -1.0, 0.5])
    bench.sensor = {"force_N": tuple(drifted.tolist())}
    assert np.linalg.norm(bench.settle().force_N) == pytest.approx(np.sqrt(5.25))
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert reply.accepted
    assert reply.value == pytest.approx(np.sqrt(5.25))
    assert bench.settle().force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert bench.said().calibration == "cell file, tared"


def test_tare_is_refused_in_contact(bench: WrenchBench) -> None:
    """More than the cell allows is not drift; the number and the limit are told."""
    bench.force_N = np.array([0.0, 0.0, CELL.force.tare_max_N + 0.1])
    bench.settle()
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code, reply.limit) == (False, "contact", CELL.force.tare_max_N)
    assert bench.settle().force_N[2] == pytest.approx(10.1)


def test_tare_is_refused_in_motion(bench: WrenchBench) -> None:
    """By the controller's bit, by the way that the flange has gone, and by the angle."""
    bench.pass_s(0.4)
    bench.status = RobotStatus(moving=True)
    bench.step()
    assert bench.ask(topics.TARE, Empty()).code == "moving"
    bench.status = RobotStatus()
    bench.p_m = bench.p_m + np.array([0.0, 0.0, 3e-4])
    bench.step()
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.code, reply.limit) == ("moving", 2e-4)
    assert reply.value == pytest.approx(3e-4)
    bench.pass_s(0.3)
    bench.R_base_flange = rotation_from_vector(np.array([0.02, 0.0, 0.0])) @ bench.R_base_flange
    bench.step()
    assert bench.ask(topics.TARE, Empty()).code == "moving"
    bench.pass_s(0.3)
    assert bench.ask(topics.TARE, Empty()).accepted


def test_tare_needs_inputs_and_a_full_window(bench: WrenchBench) -> None:
    """Refused with what is missing; a window that began with a gap is not full."""
    bench.pass_s(0.1)
    assert bench.ask(topics.TARE, Empty()).code == "wait"
    bench.silent = {"sensor"}
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.code, reply.accepted) == ("input", False)
    assert "sensor/wrench stale" in reply.text
    bench.silent = set()
    bench.step(2)
    assert bench.ask(topics.TARE, Empty()).code == "wait"

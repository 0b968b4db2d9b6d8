"""A new calibration in a running cell: accepted at rest and without contact, else refused."""

from typing import Any

import numpy as np
import pytest

from common.config.calibration import CalibrationSection, Residuals
from common.config.cell import CellConfig
from common.config.cell_terms import FrameSection
from common.runtime.service import HasNumbers
from forcemesh import topics
from forcemesh.messages import RegulatorTarget, RobotStatus
from forcemesh.requests import AxesRequest, CalibrationRequest, Empty, Reply
from services.wrench.active_calibration import HEAVIER, initial_calibration
from tests.fakes.wrench_bench import BIAS_N, BIAS_NM, IDEAL, WrenchBench
from tests.unit.common.config.test_calibration import NOTHING_LEFT, calibration

TRUE_PAYLOAD = IDEAL.payload
REAL = IDEAL.model_copy(update={"sensor": IDEAL.sensor.model_copy(update={"axes_given": False})})
HEAVY = TRUE_PAYLOAD.model_copy(update={"mass_kg": 2.0})
ON_A_WALL = TRUE_PAYLOAD.model_copy(update={"gravity_direction_in_base": (1.0, 0.0, 0.0)})
FRAMES = {"T_flange_tcp": IDEAL.tool.T_flange_tcp, "T_flange_sensor": IDEAL.sensor.T_flange_sensor}


def demo_calibration(**changes: Any) -> CalibrationSection:
    """Return a calibration that is correct for the bench's tool."""
    return calibration(**({"payload": TRUE_PAYLOAD, **FRAMES} | changes))


def residuals(force_N: float = 0.02, torque_Nm: float = 0.001) -> Residuals:
    """Return the residuals of the worst pose of a verification."""
    return NOTHING_LEFT.model_copy(update={"force_max_N": force_N, "torque_max_Nm": torque_Nm})


def with_calibration(found: CalibrationSection | None, **payload: Any) -> CellConfig:
    """Return the bench's cell with a calibration, or with another payload section."""
    section = IDEAL.payload.model_copy(update=payload)
    return IDEAL.model_copy(update={"calibration": found or "none", "payload": section})


@pytest.fixture
def bench() -> WrenchBench:
    """Return a service at rest that uses the cell file's own payload."""
    bench = WrenchBench()
    bench.pass_s(0.3)
    return bench


def send_calibration(bench: WrenchBench, found: CalibrationSection) -> Reply:
    """Request another calibration."""
    return bench.ask(topics.CALIBRATE, CalibrationRequest(calibration_json=found.model_dump_json()))


# --- at the start ---------------------------------------------------------------------------------


def test_the_calibration_replaces_the_cell_files_payload() -> None:
    """From the start on each wrench has its revision and mounting and is marked as calibrated."""
    found = demo_calibration()
    bench = WrenchBench(with_calibration(found, mass_kg=0.1, bias_force_N=(9.0, 9.0, 9.0)))
    message = bench.settle()
    assert message.force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert (message.calibration, message.calibrated, message.calibration_fault) == (
        found.revision,
        True,
        "",
    )
    turned = TRUE_PAYLOAD.model_copy(update={"mounting_rotation_rad": (0.0, 0.0, 0.1)})
    message = WrenchBench(with_calibration(demo_calibration(payload=turned))).settle()
    assert message.mounting_rotation_rad == (0.0, 0.0, 0.1)


def test_without_a_calibration_file_force_control_is_refused() -> None:
    """A file that is missing does not make the cell file's payload a calibration."""
    cell = with_calibration(None).model_copy(update={"calibration": None})
    message = WrenchBench(cell).settle()
    assert message.valid  # for moves, and for the calibration itself
    assert not message.calibrated
    assert message.calibration_fault.startswith("calibrate first: ")
    assert "forcemesh calibrate" in message.calibration_fault


@pytest.mark.parametrize("accept", [False, True])
def test_a_payload_of_zeros_is_no_calibration(accept: bool) -> None:
    """The cell file may accept it explicitly (H45); the wrench is published in both cases."""
    nothing = {"mass_kg": 0.0, "com_m": (0.0, 0.0, 0.0), "accept_uncalibrated": accept}
    message = WrenchBench(with_calibration(None, **nothing)).settle()
    assert message.valid
    assert message.calibrated is accept
    assert ("forcemesh calibrate" in message.calibration_fault) is not accept


def tilted_sensor(o_deg: float) -> FrameSection:
    """Return the demo's mounting of the sensor, turned about the flange's z axis."""
    return FrameSection(position_m=(0.0, 0.0, 0.02), oat_deg=(o_deg, 0.0, 0.0))


OTHERS = [
    ({"cell": "other"}, "of cell other"),
    ({"tool": "gripper"}, "of tool 'gripper'"),
    ({"T_flange_tcp": FrameSection(position_m=(0.0, 0.0, 0.165))}, "5.0 mm"),
    ({"T_flange_sensor": tilted_sensor(120.0)}, "90.0 degrees"),
    ({"T_flange_tcp": FrameSection(position_m=(0.0, 0.0, 0.16013))}, "0.1 mm"),
    ({"T_flange_sensor": tilted_sensor(30.13)}, "0.1 degrees"),
    ({"payload": ON_A_WALL}, "gravity 90 degrees from gravity_direction_in_base"),
    ({"payload": HEAVY}, "2.00 kg, but contact.inertia_kg is 1.2"),
    ({"verified": None}, "not verified"),
    ({"verified": residuals(force_N=2.1)}, "2.10 N"),
    ({"verified": residuals(torque_Nm=0.31)}, "0.310 N m"),
]


def test_a_heavier_tool_than_the_gains_are_bounded_for_is_not_calibrated() -> None:
    """The loop would oscillate on a soft contact; a deviation up to a tenth is accepted."""
    assert not WrenchBench(with_calibration(None, mass_kg=2.0)).settle().calibrated
    heaviest_kg = HEAVIER * IDEAL.contact.inertia_kg
    assert WrenchBench(with_calibration(None, mass_kg=heaviest_kg)).settle().calibrated


@pytest.mark.parametrize(("changes", "reason"), OTHERS)
def test_a_calibration_of_another_setup_is_not_valid(changes: dict[str, Any], reason: str) -> None:
    """Another cell, tool, tool centre point or sensor mounting: the fault names the difference."""
    message = WrenchBench(with_calibration(demo_calibration(**changes))).settle()
    assert message.valid
    assert not message.calibrated
    assert reason in message.calibration_fault


@pytest.mark.parametrize(("sign", "objection"), [(1.0, ""), (-1.0, "gravity 180 degrees")])
def test_a_direction_whose_square_is_above_1_by_rounding_has_an_angle(sign, objection) -> None:
    """Gravity exactly as the cell file says, or exactly the other way."""
    down = (-0.9124211282466754, -0.3509312031717982, 0.21055872190307892)
    found = tuple(sign * part for part in down)
    payload = TRUE_PAYLOAD.model_copy(update={"gravity_direction_in_base": found})
    cell = with_calibration(demo_calibration(payload=payload))
    cell = cell.model_copy(update={"gravity_direction_in_base": down})
    assert objection in initial_calibration(cell).objection


def test_frames_that_were_typed_again_may_be_rounded() -> None:
    """Up to 0.1 mm and 0.1 degrees they are those of the calibration."""
    tcp = FrameSection(position_m=(0.0, 0.0, 0.16007))
    found = demo_calibration(T_flange_tcp=tcp, T_flange_sensor=tilted_sensor(30.07))
    assert WrenchBench(with_calibration(found)).settle().calibrated


def test_a_calibration_of_another_sensor_is_not_valid(bench: WrenchBench) -> None:
    """A sensor without a number has only a calibration without one; a change counts at once."""
    in_use = initial_calibration(with_calibration(demo_calibration(sensor="FT1")))
    assert in_use.fault("FT1") == ""
    assert "FT2" in in_use.fault("FT2")
    assert "reports no serial number" in in_use.fault("")
    unnumbered = initial_calibration(with_calibration(demo_calibration(sensor="")))
    assert unnumbered.fault("") == unnumbered.fault("FT1") == ""
    bench = WrenchBench(with_calibration(demo_calibration(sensor="FT1")))
    bench.sensor = {"serial": "FT1"}
    assert bench.settle().calibrated
    for serial in ("FT2", ""):
        bench.sensor = {"serial": serial}
        assert not bench.settle().calibrated


# --- in operation ---------------------------------------------------------------------------------


def test_a_newer_calibration_is_used_at_once(bench: WrenchBench) -> None:
    """It replaces a tare, because its bias is newer."""
    bias_N = tuple((BIAS_N + np.array([0.3, 0.0, 0.0])).tolist())
    found = demo_calibration(payload=TRUE_PAYLOAD.model_copy(update={"bias_force_N": bias_N}))
    assert bench.ask(topics.TARE, Empty()).accepted
    reply = send_calibration(bench, found)
    assert reply.accepted
    assert "0.30 N" in reply.text
    assert np.linalg.norm(bench.settle().force_N) == pytest.approx(0.3)
    assert bench.published().calibration == found.revision
    bench.pass_s(0.3)
    assert bench.ask(topics.TARE, Empty()).accepted
    bench.settle()
    assert (bench.published().calibration, bench.published().tared) == (found.revision, True)


def test_the_residual_torque_is_that_about_the_tcp(bench: WrenchBench) -> None:
    """A push at the TCP leaves a force, and no torque about it."""
    bench.force_N = np.array([1.0, 0.0, 0.0])
    bench.settle()
    bench.pass_s(0.3)
    reply = send_calibration(bench, demo_calibration())
    assert reply.accepted
    assert "residual 1.00 N and 0.000 N m" in reply.text


@pytest.mark.parametrize(
    ("bias", "limit"),
    [
        ({"bias_force_N": (*BIAS_N[:2], BIAS_N[2] + 4.9)}, IDEAL.force.idle_max_N),
        ({"bias_torque_Nm": (*BIAS_NM[:2], BIAS_NM[2] + 4.9)}, IDEAL.force.idle_max_Nm),
    ],
)
def test_a_calibration_with_a_residual_wrench_is_refused_with_its_value(
    bench: WrenchBench, bias: dict[str, Any], limit: float
) -> None:
    """The tool is in contact, or it is another tool; the calibration in use stays."""
    found = demo_calibration(payload=TRUE_PAYLOAD.model_copy(update=bias))
    reply = send_calibration(bench, found)
    assert (reply.accepted, reply.code, reply.limit) == (False, "contact", limit)
    assert reply.value == pytest.approx(4.9, abs=1e-6)
    bench.settle()
    assert bench.published().calibration == "cell file"


def test_tare_and_calibration_are_refused_while_force_feedback_runs(bench: WrenchBench) -> None:
    """The regulator would respond with motion."""
    publish_inputs = bench.before_step

    def publish_regulator_too() -> None:
        publish_inputs()
        bench.put(topics.REGULATOR_TARGET, RegulatorTarget(mode="position"))

    bench.before_step = publish_regulator_too
    bench.step()
    assert bench.ask(topics.TARE, Empty()).code == "busy"
    assert send_calibration(bench, demo_calibration()).code == "busy"
    bench.before_step = publish_inputs
    bench.pass_s(1.0)
    assert send_calibration(bench, demo_calibration()).accepted


def test_a_calibration_is_refused_in_motion_and_without_inputs(bench: WrenchBench) -> None:
    """So is one of another setup, whatever the inputs are."""
    bench.status = RobotStatus(moving=True)
    bench.step()
    assert send_calibration(bench, demo_calibration()).code == "moving"
    bench.status = RobotStatus()
    bench.silent = {"robot"}
    bench.pass_s(1.0)
    assert send_calibration(bench, demo_calibration()).code == "stale"
    assert send_calibration(WrenchBench(), demo_calibration()).code == "wait"
    assert send_calibration(WrenchBench(), demo_calibration(payload=HEAVY)).code == "payload"


def test_an_invalid_calibration_is_refused(bench: WrenchBench) -> None:
    """The refusal names the wrong field."""
    reply = bench.ask(topics.CALIBRATE, CalibrationRequest(calibration_json='{"cell": 1}'))
    assert (reply.accepted, reply.code) == (False, "malformed")
    assert "cell" in reply.text


def test_the_filters_delay_is_reported(bench: WrenchBench) -> None:
    """The delay is that of the low-pass plus half the median's window."""
    cell = bench.cell
    expected_s = cell.filter.lowpass_s + (cell.filter.median - 1) / 2 / cell.rates.sensor_hz
    assert isinstance(bench.service, HasNumbers)
    reason = bench.service.numbers(bench.clock.now_ns())
    assert reason.keys() == {"filter_delay_s", "tare_age_h"}
    assert reason["filter_delay_s"] == pytest.approx(expected_s)
    assert 0.0 <= reason["tare_age_h"] < 1.0


# --- checked axes ---------------------------------------------------------------------------------


def test_axes_are_checked_for_the_calibration_in_use_only() -> None:
    """A check under another calibration does not count; a new calibration requires a new check."""
    bench = WrenchBench(REAL)
    bench.pass_s(0.3)
    in_use = bench.published().calibration
    assert not bench.published().axes_checked
    reply = bench.ask(topics.AXES, AxesRequest(calibration="00000000"))
    assert (reply.accepted, reply.code) == (False, "payload")
    assert "'00000000'" in reply.text
    bench.pass_s(0.1)
    assert not bench.published().axes_checked
    assert bench.ask(topics.AXES, AxesRequest(calibration=in_use)).accepted
    assert bench.ask(topics.TARE, Empty()).accepted  # it changes no axis
    bench.pass_s(0.3)
    assert bench.published().axes_checked
    assert send_calibration(bench, demo_calibration()).accepted
    bench.pass_s(0.1)
    assert not bench.published().axes_checked


@pytest.mark.parametrize(
    ("arm", "other", "is_checked"),
    [("rs007l", {}, True), ("panda", {}, False), ("rs007l", {"sensor": "x"}, False)],
)
def test_a_calibration_whose_poses_showed_the_axes_is_their_check(
    arm: str, other: dict[str, Any], is_checked: bool
) -> None:
    """With that calibration and that arm; the revision is that of the calibration without it."""
    found = demo_calibration()
    of = demo_calibration(**other).with_axes(arm, "calibrate", found.made_at, torques=False)
    checked = found.model_copy(update={"axes": of.axes})
    bench = WrenchBench(REAL)
    bench.pass_s(0.3)
    assert send_calibration(bench, checked).accepted
    bench.pass_s(0.1)
    published = bench.published()
    assert (published.calibration, published.axes_checked) == (found.revision, is_checked)
    assert not published.torques_checked
    request = AxesRequest(calibration=found.revision, torques=True)
    assert bench.ask(topics.AXES, request).accepted
    bench.pass_s(0.1)
    assert bench.published().torques_checked


def test_a_simulated_cell_states_that_its_axes_are_right(bench: WrenchBench) -> None:
    """No check is needed, whatever the calibration."""
    assert bench.published().axes_checked
    assert send_calibration(bench, demo_calibration()).accepted
    bench.pass_s(0.1)
    assert bench.published().axes_checked
    assert bench.published().torques_checked

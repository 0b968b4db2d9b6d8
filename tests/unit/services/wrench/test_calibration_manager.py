"""Another calibration while the cell is up: taken at rest and free, refused with the reason."""

import json
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
from services.wrench.active_calibration import LARGEST, initial_calibration
from tests.fakes.wrench_bench import BIAS_N, BIAS_NM, IDEAL, WrenchBench
from tests.unit.common.config.test_calibration import NOTHING_LEFT, calibration

TRUTH = IDEAL.payload
HEAVY = TRUTH.model_copy(update={"mass_kg": 2.0})
FRAMES = {"T_flange_tcp": IDEAL.tool.T_flange_tcp, "T_flange_sensor": IDEAL.sensor.T_flange_sensor}


def of_the_demo(**changes: Any) -> CalibrationSection:
    """Return a calibration that is true for the bench's tool."""
    return calibration(**({"payload": TRUTH, **FRAMES} | changes))


def left(force_N: float = 0.02, torque_Nm: float = 0.001) -> Residuals:
    """Return what the worst fresh pose of a verification left."""
    return NOTHING_LEFT.model_copy(update={"force_max_N": force_N, "torque_max_Nm": torque_Nm})


def with_calibration(found: CalibrationSection | None, **payload: Any) -> CellConfig:
    """Return the bench's cell with a calibration, or with another payload section."""
    section = IDEAL.payload.model_copy(update=payload)
    return IDEAL.model_copy(update={"calibration": found, "payload": section})


@pytest.fixture
def bench() -> WrenchBench:
    """A service at rest that uses what the cell file says by hand."""
    bench = WrenchBench()
    bench.pass_s(0.3)
    return bench


def ask(bench: WrenchBench, found: CalibrationSection) -> Reply:
    """Ask for another calibration."""
    return bench.ask(topics.CALIBRATE, CalibrationRequest(calibration_json=found.model_dump_json()))


# --- from the start -------------------------------------------------------------------------------


def test_the_calibration_takes_the_place_of_the_cell_files_payload() -> None:
    """From the start; each wrench names its revision, and says that it may be relied on."""
    found = of_the_demo()
    bench = WrenchBench(with_calibration(found, mass_kg=0.1, bias_force_N=(9.0, 9.0, 9.0)))
    said = bench.settle()
    assert said.force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert (said.calibration, said.calibrated, said.calibration_fault) == (found.revision, True, "")


def test_without_one_the_cell_file_is_named() -> None:
    """A payload written by hand is somebody's word."""
    said = WrenchBench().settle()
    assert (said.calibration, said.calibrated) == ("cell file", True)


@pytest.mark.parametrize("accept", [False, True])
def test_a_payload_of_zeros_is_no_calibration(accept: bool) -> None:
    """Unless the cell file takes it upon itself (H45); the wrench is published all the same."""
    nothing = {"mass_kg": 0.0, "com_m": (0.0, 0.0, 0.0), "accept_uncalibrated": accept}
    said = WrenchBench(with_calibration(None, **nothing)).settle()
    assert said.valid
    assert said.calibrated is accept
    assert ("forcemesh calibrate" in said.calibration_fault) is not accept


OTHERS = [
    ({"cell": "other"}, "of cell other"),
    ({"tool": "gripper"}, "of tool 'gripper'"),
    ({"T_flange_tcp": FrameSection(position_m=(0.0, 0.0, 0.165))}, "5.0 mm"),
    (
        {"T_flange_sensor": FrameSection(position_m=(0.0, 0.0, 0.02), oat_deg=(120.0, 0.0, 0.0))},
        "90.0 degrees",
    ),
    ({"payload": HEAVY}, "2.00 kg, but contact.inertia_kg is 1.2"),
    ({"verified": None}, "not verified"),
    ({"verified": left(force_N=2.1)}, "2.10 N"),
    ({"verified": left(torque_Nm=0.31)}, "0.310 N m"),
]


def test_a_heavier_tool_than_the_gains_are_bounded_for_does_not_hold() -> None:
    """Written by hand it swings on a soft contact just the same; within a tenth it is believed."""
    assert not WrenchBench(with_calibration(None, mass_kg=2.0)).settle().calibrated
    assert WrenchBench(with_calibration(None, mass_kg=1.3)).settle().calibrated


@pytest.mark.parametrize(("changes", "told"), OTHERS)
def test_a_calibration_of_something_else_does_not_hold(changes: dict[str, Any], told: str) -> None:
    """Another cell, tool, tool centre point or place of the sensor: told, with what differs."""
    said = WrenchBench(with_calibration(of_the_demo(**changes))).settle()
    assert said.valid
    assert not said.calibrated
    assert told in said.calibration_fault


def test_a_calibration_of_another_sensor_does_not_hold(bench: WrenchBench) -> None:
    """The serial number is compared where both are known, also when the sensor is changed live."""
    in_use = initial_calibration(with_calibration(of_the_demo(sensor="FT1")))
    assert in_use.fault("") == in_use.fault("FT1") == ""
    assert "FT2" in in_use.fault("FT2")
    bench = WrenchBench(with_calibration(of_the_demo(sensor="FT1")))
    bench.sensor = {"serial": "FT1"}
    assert bench.settle().calibrated
    bench.sensor = {"serial": "FT2"}
    assert not bench.settle().calibrated


# --- while the cell is up -------------------------------------------------------------------------


def test_a_newer_calibration_is_used_at_once(bench: WrenchBench) -> None:
    """And replaces a tare: its bias is newer."""
    bias_N = tuple((BIAS_N + np.array([0.3, 0.0, 0.0])).tolist())
    found = of_the_demo(payload=TRUTH.model_copy(update={"bias_force_N": bias_N}))
    assert bench.ask(topics.TARE, Empty()).accepted
    reply = ask(bench, found)
    assert reply.accepted
    assert "0.30 N" in reply.text
    assert np.linalg.norm(bench.settle().force_N) == pytest.approx(0.3)
    assert bench.said().calibration == found.revision
    bench.pass_s(0.3)
    assert bench.ask(topics.TARE, Empty()).accepted
    bench.settle()
    assert bench.said().calibration == f"{found.revision}, tared"


def test_a_calibration_that_leaves_a_force_is_refused_with_it(bench: WrenchBench) -> None:
    """The tool is in contact, or it is not this tool; the one in use stays."""
    lighter = TRUTH.model_copy(update={"mass_kg": TRUTH.mass_kg - 0.5})
    reply = ask(bench, of_the_demo(payload=lighter))
    assert (reply.accepted, reply.code) == (False, "contact")
    assert (reply.value, reply.limit) == (pytest.approx(4.905, abs=0.01), IDEAL.force.idle_max_N)
    bench.settle()
    assert bench.said().calibration == "cell file"


def test_a_calibration_that_leaves_a_torque_is_refused_with_it(bench: WrenchBench) -> None:
    """Its force may be right and its torque wrong: judged about the TCP, as the preflight does."""
    bias_Nm = tuple((BIAS_NM + np.array([0.0, 0.0, 0.5])).tolist())
    reply = ask(bench, of_the_demo(payload=TRUTH.model_copy(update={"bias_torque_Nm": bias_Nm})))
    assert (reply.accepted, reply.code) == (False, "contact")
    assert (reply.value, reply.limit) == (pytest.approx(0.5, abs=1e-6), IDEAL.force.idle_max_Nm)
    assert "0.50 N m" in reply.text
    bench.settle()
    assert bench.said().calibration == "cell file"


@pytest.mark.parametrize("turn_rad", [(0.0, 0.0, np.pi), (0.15, 0.15, 0.0)])
def test_a_large_mounting_rotation_is_refused_with_the_reason(
    bench: WrenchBench, turn_rad: tuple[float, float, float]
) -> None:
    """A sensor that sits turned is for the cell file to say, not for a fit to hide."""
    text = of_the_demo().model_dump_json()
    turned = json.loads(text) | {"revision": ""}
    turned["payload"]["mounting_rotation_rad"] = turn_rad
    request = CalibrationRequest(calibration_json=json.dumps(turned))
    reply = bench.ask(topics.CALIBRATE, request)
    assert (reply.accepted, reply.code) == (False, "malformed")
    assert "T_flange_sensor" in reply.text
    assert "the limit is 0.2 rad" in reply.text


@pytest.mark.parametrize(("changes", "told"), OTHERS)
def test_a_calibration_of_something_else_is_refused(
    bench: WrenchBench, changes: dict[str, Any], told: str
) -> None:
    """With what differs."""
    reply = ask(bench, of_the_demo(**changes))
    assert (reply.accepted, reply.code) == (False, "payload")
    assert told in reply.text


def test_nothing_is_taken_while_force_feedback_runs(bench: WrenchBench) -> None:
    """Neither a tare nor a calibration: the regulator would answer with motion."""
    speak = bench.before_step

    def speak_as_regulator_too() -> None:
        speak()
        bench.put(topics.REGULATOR_TARGET, RegulatorTarget(mode="position"))

    bench.before_step = speak_as_regulator_too
    bench.step()
    assert bench.ask(topics.TARE, Empty()).code == "busy"
    assert ask(bench, of_the_demo()).code == "busy"
    bench.before_step = speak
    bench.pass_s(1.0)
    assert ask(bench, of_the_demo()).accepted


def test_nothing_is_taken_in_motion_or_without_inputs(bench: WrenchBench) -> None:
    """As a tare."""
    bench.status = RobotStatus(moving=True)
    bench.step()
    assert ask(bench, of_the_demo()).code == "moving"
    bench.status = RobotStatus()
    bench.silent = {"robot"}
    bench.pass_s(1.0)
    assert ask(bench, of_the_demo()).code == "stale"
    assert ask(WrenchBench(), of_the_demo()).code == "wait"


@pytest.mark.parametrize(
    ("text", "told"),
    [("", "calibration"), ("[]", "calibration"), ("{}", "cell"), ('{"cell": 1}', "cell")],
)
def test_what_is_no_calibration_is_refused(bench: WrenchBench, text: str, told: str) -> None:
    """With the field that is wrong."""
    reply = bench.ask(topics.CALIBRATE, CalibrationRequest(calibration_json=text))
    assert (reply.accepted, reply.code) == (False, "malformed")
    assert told in reply.text


def test_the_filters_delay_is_told(bench: WrenchBench) -> None:
    """Low-pass and half the median's window."""
    cell = bench.cell
    expected_s = cell.filter.lowpass_s + (cell.filter.median - 1) / 2 / cell.rates.sensor_hz
    assert isinstance(bench.service, HasNumbers)
    told = bench.service.numbers(bench.clock.now_ns())
    assert told.keys() == {"filter_delay_s", "tare_age_h"}
    assert told["filter_delay_s"] == pytest.approx(expected_s)
    assert 0.0 <= told["tare_age_h"] < 1.0


# --- axes that were checked -----------------------------------------------------------------------


def test_axes_are_proved_for_the_calibration_in_use_and_no_other(bench: WrenchBench) -> None:
    """A check under another calibration proves nothing; a new calibration asks for a new check."""
    in_use = bench.said().calibration
    assert not bench.said().axes_checked
    reply = bench.ask(topics.AXES, AxesRequest(calibration="00000000"))
    assert (reply.accepted, reply.code) == (False, "payload")
    assert "'00000000'" in reply.text
    bench.pass_s(0.1)
    assert not bench.said().axes_checked
    assert bench.ask(topics.AXES, AxesRequest(calibration=in_use)).accepted
    bench.pass_s(0.1)
    assert bench.said().axes_checked
    assert ask(bench, of_the_demo()).accepted
    bench.pass_s(0.1)
    assert not bench.said().axes_checked


def test_a_number_that_no_calibration_has_is_refused_with_its_place(bench: WrenchBench) -> None:
    """Finite, and yet beyond all that the arithmetic was tried with; the limit itself passes."""
    reply = ask(bench, of_the_demo(fit=left(LARGEST * (1.0 + 1e-9))))
    assert not reply.accepted
    assert "fit.force_max_N" in reply.text
    assert "outside +-1e+06" in reply.text
    assert ask(bench, of_the_demo(fit=left(LARGEST))).code != reply.code

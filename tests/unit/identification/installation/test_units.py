"""Wrong units, wrong payloads, wrong attitudes: each told by its own sentence with its numbers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.payload import Payload
from common.motion.frames import Oat, R_from_oat, R_from_quaternion, oat_from_R, quaternion_from_R
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation, rejection_reason
from identification.installation.terms import ExpectedInstallation
from identification.recording import Samples
from tests.fakes.bench import CELL
from tests.fakes.installations import PAYLOAD, belief, oat_matrix, readings

SEEN = readings(poses=8, seed=4)


def scaled(force: float = 1.0, torque: float = 1.0, wiring=SIGNED[0]) -> Samples:
    """Return readings in other units, in any wiring of all six channels."""
    seen = readings(force=wiring, torque=wiring, poses=8, seed=4)
    return replace(seen, force_N=force * seen.force_N, torque_Nm=torque * seen.torque_Nm)


def only(seen: Samples, of: ExpectedInstallation | None = None):
    """Return the one finding."""
    (finding,) = judge_installation(seen, of or belief()).findings
    return finding


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (1 / 9.80665, "kilograms-force"),
        (1 / 4.44822, "pounds-force"),
        (1e-3, "kilonewtons"),
        (1e3, "millinewtons"),
        (9.80665, "multiplied by 9.81"),
        (4.44822, "multiplied by 4.45"),
    ],
)
def test_a_wrong_unit_of_force_is_named(times, words) -> None:
    """By the mass that is known, to a few per cent; dividing by the factor fixes it."""
    weights = [replace(belief(), mass_kg=mass_kg, com_m=None) for mass_kg in (0.95, 1.0, 1.05)]
    findings = [only(scaled(force=times), of) for of in weights]
    for finding in findings:
        assert finding.code == "force_unit"
        assert words in finding.text
        assert finding.kind == "installation"
    factor = float(findings[0].remedy.split()[4].rstrip(","))
    assert judge_installation(scaled(force=times / factor), belief()).verdict == "right"


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (1e3, "newton millimetres"),
        (1e2, "newton centimetres"),
        (8.8507, "inch-pounds"),
        (10.197, "kilogram-force centimetres"),
        (0.10197, "kilogram-force metres"),
    ],
)
def test_a_wrong_unit_of_torque_is_named(times, words) -> None:
    """By the lever that is known; without one, by a lever that no tool has."""
    finding = only(scaled(torque=times))
    assert finding.code == "torque_unit"
    assert words in finding.text
    unknown = replace(belief(), com_m=None)
    if times > 10.0:
        assert words in only(scaled(torque=times), unknown).text


def test_wrong_units_beside_wrong_axes_are_both_told() -> None:
    """Neither hides the other, in any wiring."""
    for number, wiring in enumerate(SIGNED[1:]):
        found = judge_installation(scaled(1 / 9.80665, 1 / 9.80665, wiring), belief()).findings
        codes = {finding.code for finding in found}
        assert {"force_unit", "torque_unit"} < codes, number
        assert codes & {"force_axes", "mounting", "reaction"}, number


@settings(max_examples=80, deadline=None)
@given(times=st.floats(0.5, 1.9), seed=st.integers(0, 10**6))
def test_a_payload_that_is_wrong_is_told_with_both_numbers(times, seed) -> None:
    """Beyond a tenth; it is no reason to refuse a calibration, which corrects it."""
    seen = readings(seed=seed)
    found = judge_installation(seen, replace(belief(), mass_kg=times))
    if 0.92 < times < 1.1:
        assert found.verdict == "right"
    elif not 0.9 < times < 1.13:
        (finding,) = found.findings
        assert finding.code == "mass"
        assert f"the cell file says {times:.3g} kg" in finding.text
        assert "write payload.mass_kg: 1.00" in finding.remedy or "0.99" in finding.remedy
    assert rejection_reason(seen, replace(belief(), mass_kg=times)) is None


@settings(max_examples=80, deadline=None)
@given(
    shift_mm=st.floats(0.0, 8.0) | st.floats(12.0, 40.0),
    way=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
)
def test_a_centre_of_mass_that_is_off_is_told_with_its_place(shift_mm, way) -> None:
    """20 mm beside it: where it is; 8 mm are within what a calibration finds anyway."""
    shift = 1e-3 * shift_mm * np.array(way) / np.linalg.norm(way)
    of = replace(belief(), com_m=np.array(PAYLOAD.com_m) + shift)
    found = judge_installation(SEEN, of)
    if shift_mm <= 8.0:
        assert found.verdict == "right"
        return
    (finding,) = found.findings
    assert finding.code == "com"
    assert "the centre of mass is at (12, -8, 55) mm" in finding.text
    assert rejection_reason(SEEN, of) is None


@pytest.mark.parametrize("key", ["p_flange_sensor_m", "p_flange_tcp_m", "com_m"])
def test_millimetres_in_the_cell_file_are_told(key) -> None:
    """Each length by its key, with the metres to write; the rest is judged in metres."""
    of = belief()
    (finding,) = judge_installation(SEEN, replace(of, **{key: 1e3 * getattr(of, key)})).findings
    assert finding.code == "length"
    assert "it is in millimetres" in finding.text


# --- attitudes ------------------------------------------------------------------------------------


def with_attitudes(change) -> Samples:
    """Return the readings beside other attitudes."""
    return replace(SEEN, R_base_sensor=np.array([change(R) for R in SEEN.R_base_sensor]))


def oat_times(R, times: float):
    """Return the attitude whose O, A, T are so many times larger."""
    return R_from_oat(Oat(*(times * angle for angle in oat_from_R(R))))


def w_first(R):
    """Return the attitude of a quaternion whose w stands first."""
    x, y, z, w = quaternion_from_R(R)
    return R_from_quaternion((w, x, y, z))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda R: oat_times(R, np.pi / 180.0), "radians are taken for degrees"),
        (lambda R: oat_times(R, 180.0 / np.pi), "degrees taken for radians"),
        (lambda R: R.T, "of the base in the sensor"),
        (w_first, "in the order w x y z"),
    ],
    ids=["radians for degrees", "degrees for radians", "transposed", "w first"],
)
def test_attitudes_in_a_wrong_unit_or_order_are_told(change, words) -> None:
    """No wiring explains the readings; the sentence says what may."""
    finding = only(with_attitudes(change))
    assert finding.code == "attitude"
    assert words in finding.text
    assert rejection_reason(with_attitudes(change), belief()) == str(finding)


def turned(samples: Samples) -> Samples:
    """Return the readings in base axes, bias included."""
    force, torque = (
        np.einsum("nij,nj->ni", samples.R_base_sensor, v)
        for v in (samples.force_N, samples.torque_Nm)
    )
    return replace(samples, force_N=force, torque_Nm=torque)


def test_readings_in_base_axes_are_told() -> None:
    """As a driver publishes them that turns them itself."""
    assert "in base axes" in only(turned(SEEN)).text


def test_forces_and_torques_exchanged_are_told() -> None:
    """The order of many a library: torque first."""
    swapped = replace(SEEN, force_N=SEEN.torque_Nm, torque_Nm=SEEN.force_N)
    assert "exchanged" in only(swapped).text


def test_an_arm_on_a_wall_is_told_with_the_direction_of_gravity() -> None:
    """Right axes, another gravity: what to write is in the sentence."""
    payload = replace(PAYLOAD, gravity_direction_in_base=(1.0, 0.0, 0.0))
    finding = only(readings(payload, poses=8))
    assert finding.code == "gravity"
    assert finding.remedy.endswith("[1.000, 0.000, 0.000]") or "[1.000, " in finding.remedy


@pytest.mark.parametrize("axis", range(3))
def test_a_dead_channel_is_named(axis) -> None:
    """A broken wire shows a constant."""
    force = SEEN.force_N.copy()
    force[:, axis] = 0.3
    finding = only(replace(SEEN, force_N=force))
    assert finding.code == "gain"
    assert f"F{'xyz'[axis]} without signal" in finding.remedy


def test_a_dead_torque_channel_is_told() -> None:
    """The forces are right; what is left is no moment of a weight."""
    torque = SEEN.torque_Nm.copy()
    torque[:, 0] = 0.0
    finding = only(replace(SEEN, torque_Nm=torque))
    assert finding.code == "torque_axes"


def test_a_sensor_that_shows_no_weight_is_told() -> None:
    """Whatever the attitude, the same force: noise alone."""
    noise = 0.01 * np.random.default_rng(1).normal(size=(8, 3))
    assert only(replace(SEEN, force_N=noise)).code == "no_weight"
    unknown = replace(belief(), mass_kg=None, com_m=None)
    assert only(replace(SEEN, force_N=noise), unknown).code == "no_weight"


@pytest.mark.parametrize("pose", range(8))
def test_a_pose_in_contact_is_left_out_and_named(pose) -> None:
    """One touched pose among eight is no installation: the others are judged, right or wrong."""
    for number in (0, 1, 10, 30):
        seen = scaled(wiring=SIGNED[number])
        force = seen.force_N.copy()
        force[pose] += np.array([3.0, 2.0, -4.0])
        found = judge_installation(replace(seen, force_N=force), belief())
        assert found.verdict == ("wrong" if number else "right")
        assert f"pose {pose + 1}, left out: contact, or motion" in found.unidentified


def test_readings_that_fit_nothing_say_what_to_compare() -> None:
    """Forces at random beside attitudes at random."""
    rng = np.random.default_rng(2)
    junk = replace(SEEN, force_N=10.0 * rng.normal(size=(8, 3)))
    finding = only(junk)
    assert finding.code == "attitude"
    assert "compare the recorded attitudes" in finding.remedy


# --- belief ---------------------------------------------------------------------------------------


def test_a_cell_file_says_what_is_believed() -> None:
    """Mass, lever, mounting, tool; a calibration has the last word, and no payload is none."""
    of = ExpectedInstallation.of(CELL)
    assert of.mass_kg == CELL.payload.mass_kg
    assert of.oat_deg == (30.0, 0.0, 0.0)
    assert of.p_sensor_tcp_m == pytest.approx([0.0, 0.0, 0.14])
    empty = CELL.payload.model_copy(update={"mass_kg": 0.0, "com_m": (0.0, 0.0, 0.0)})
    unknown = ExpectedInstallation.of(CELL.model_copy(update={"payload": empty}))
    assert unknown.mass_kg is None
    assert unknown.com_m is None


def test_an_arm_that_does_not_know_its_tool_is_still_told_the_axes() -> None:
    """Nothing but the readings: a turned sensor is told, and which way."""
    payload = Payload(2.0, (0.01, 0.02, 0.05), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    turn = oat_matrix((90.0, 0.0, 0.0)).T
    finding = only(readings(payload, force=turn, torque=turn), ExpectedInstallation())
    assert finding.code == "mounting"
    assert "turned by 90 degrees about z" in finding.text

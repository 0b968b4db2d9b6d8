"""Installation check: findings of wrong units, payloads and attitudes, with their numbers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.payload import Payload
from common.motion.frames import Oat, R_from_oat, R_from_quaternion, oat_from_R, quaternion_from_R
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation
from identification.recording import Samples
from tests.fakes.bench import CELL
from tests.fakes.installations import PAYLOAD, belief, oat_matrix, readings

RECORDED = readings(poses=8, seed=4)


def scaled(force: float = 1.0, torque: float = 1.0, wiring=SIGNED[0]) -> Samples:
    """Return readings in other units, in any wiring of all six channels."""
    recorded = readings(force=wiring, torque=wiring, poses=8, seed=4)
    return replace(
        recorded, force_N=force * recorded.force_N, torque_Nm=torque * recorded.torque_Nm
    )


def only(recorded: Samples, expected: ExpectedInstallation | None = None):
    """Return the one finding."""
    (finding,) = judge_installation(recorded, expected or belief()).findings
    return finding


@pytest.mark.parametrize(
    ("factor_of_unit", "words"),
    [
        (1 / 9.80665, "kilograms-force"),
        (1 / 4.44822, "pounds-force"),
        (1e-3, "kilonewtons"),
        (1e3, "millinewtons"),
        (9.80665, "multiplied by 9.81"),
        (4.44822, "multiplied by 4.45"),
    ],
)
def test_a_wrong_unit_of_force_is_named(factor_of_unit, words) -> None:
    """The known mass identifies it within a few per cent; dividing by the factor fixes it."""
    weights = [replace(belief(), mass_kg=mass_kg, com_m=None) for mass_kg in (0.95, 1.0, 1.05)]
    findings = [only(scaled(force=factor_of_unit), expected) for expected in weights]
    for finding in findings:
        assert finding.code == "force_unit"
        assert words in finding.text
        assert finding.kind == "installation"
    factor = float(findings[0].remedy.split()[4].rstrip(","))
    assert judge_installation(scaled(force=factor_of_unit / factor), belief()).verdict == "right"


@pytest.mark.parametrize(
    ("factor_of_unit", "words"),
    [
        (1e3, "newton millimetres"),
        (1e2, "newton centimetres"),
        (8.8507, "inch-pounds"),
        (10.197, "kilogram-force centimetres"),
        (0.10197, "kilogram-force metres"),
    ],
)
def test_a_wrong_unit_of_torque_is_named(factor_of_unit, words) -> None:
    """The known lever identifies it; without one, a lever that no tool has."""
    finding = only(scaled(torque=factor_of_unit))
    assert finding.code == "torque_unit"
    assert words in finding.text
    unknown = replace(belief(), com_m=None)
    if factor_of_unit > 10.0:
        assert words in only(scaled(torque=factor_of_unit), unknown).text


def test_wrong_units_and_wrong_axes_are_both_reported() -> None:
    """Neither finding hides the other, in any wiring."""
    for number, wiring in enumerate(SIGNED[1:]):
        found = judge_installation(scaled(1 / 9.80665, 1 / 9.80665, wiring), belief()).findings
        codes = {finding.code for finding in found}
        assert {"force_unit", "torque_unit"} < codes, number
        assert codes & {"force_axes", "mounting", "reaction"}, number


@settings(max_examples=80, deadline=None)
@given(mass_kg=st.floats(0.5, 1.9), seed=st.integers(0, 10**6))
def test_a_wrong_payload_is_reported_with_both_numbers(mass_kg, seed) -> None:
    """Errors above a tenth are reported; a calibration corrects them and is not refused."""
    recorded = readings(seed=seed)
    found = judge_installation(recorded, replace(belief(), mass_kg=mass_kg))
    if 0.92 < mass_kg < 1.1:
        assert found.verdict == "right"
    elif not 0.9 < mass_kg < 1.13:
        (finding,) = found.findings
        assert finding.code == "mass"
        assert f"the cell file says {mass_kg:.3g} kg" in finding.text
        assert "write payload.mass_kg: 1.00" in finding.remedy or "0.99" in finding.remedy
    assert judge_installation(recorded, replace(belief(), mass_kg=mass_kg)).rejection_reason is None


@settings(max_examples=80, deadline=None)
@given(
    shift_mm=st.floats(0.0, 8.0) | st.floats(12.0, 40.0),
    direction=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
)
def test_a_wrong_centre_of_mass_is_reported_with_its_position(shift_mm, direction) -> None:
    """Above 12 mm the finding gives the position; 8 mm pass, as a calibration corrects them."""
    shift = 1e-3 * shift_mm * np.array(direction) / np.linalg.norm(direction)
    expected = replace(belief(), com_m=np.array(PAYLOAD.com_m) + shift)
    found = judge_installation(RECORDED, expected)
    if shift_mm <= 8.0:
        assert found.verdict == "right"
        return
    (finding,) = found.findings
    assert finding.code == "com"
    assert "the centre of mass is at (12, -8, 55) mm" in finding.text
    assert judge_installation(RECORDED, expected).rejection_reason is None


@pytest.mark.parametrize("key", ["p_flange_sensor_m", "p_flange_tcp_m", "com_m"])
def test_millimetres_in_the_cell_file_are_reported(key) -> None:
    """Each length is named by its key with the metres to write; the rest is judged in metres."""
    expected = belief()
    (finding,) = judge_installation(
        RECORDED, replace(expected, **{key: 1e3 * getattr(expected, key)})
    ).findings
    assert finding.code == "length"
    assert "it is in millimetres" in finding.text


# --- attitudes ------------------------------------------------------------------------------------


def with_attitudes(change) -> Samples:
    """Return the readings with other attitudes."""
    return replace(RECORDED, R_base_sensor=np.array([change(R) for R in RECORDED.R_base_sensor]))


def oat_times(R, factor: float):
    """Return the attitude with O, A and T multiplied by a factor."""
    return R_from_oat(Oat(*(factor * angle for angle in oat_from_R(R))))


def w_first(R):
    """Return the attitude of a quaternion with w as the first number."""
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
def test_attitudes_in_a_wrong_unit_or_order_are_reported(change, words) -> None:
    """No wiring explains the readings; the finding names the possible cause."""
    finding = only(with_attitudes(change))
    assert finding.code == "attitude"
    assert words in finding.text
    assert judge_installation(with_attitudes(change), belief()).rejection_reason == str(finding)


def turned(samples: Samples) -> Samples:
    """Return the readings in base axes, bias included."""
    force, torque = (
        np.einsum("nij,nj->ni", samples.R_base_sensor, v)
        for v in (samples.force_N, samples.torque_Nm)
    )
    return replace(samples, force_N=force, torque_Nm=torque)


def test_readings_in_base_axes_are_reported() -> None:
    """A driver that rotates the readings publishes them so."""
    assert "in base axes" in only(turned(RECORDED)).text


def test_exchanged_forces_and_torques_are_reported() -> None:
    """Many libraries have the torque first."""
    swapped = replace(RECORDED, force_N=RECORDED.torque_Nm, torque_Nm=RECORDED.force_N)
    assert "exchanged" in only(swapped).text


def test_an_arm_on_a_wall_is_reported_with_the_direction_of_gravity() -> None:
    """Correct axes, another direction of gravity: the remedy gives the value to write."""
    payload = PAYLOAD.model_copy(update={"gravity_direction_in_base": (1.0, 0.0, 0.0)})
    finding = only(readings(payload, poses=8))
    assert finding.code == "gravity"
    assert finding.remedy.endswith("[1.000, 0.000, 0.000]") or "[1.000, " in finding.remedy


@pytest.mark.parametrize("axis", range(3))
def test_a_dead_channel_is_named(axis) -> None:
    """A broken wire gives a constant reading."""
    force = RECORDED.force_N.copy()
    force[:, axis] = 0.3
    finding = only(replace(RECORDED, force_N=force))
    assert finding.code == "gain"
    assert f"F{'xyz'[axis]} without signal" in finding.remedy


def test_a_dead_torque_channel_is_reported() -> None:
    """The forces are right; the remaining torques are no moment of a weight."""
    torque = RECORDED.torque_Nm.copy()
    torque[:, 0] = 0.0
    finding = only(replace(RECORDED, torque_Nm=torque))
    assert finding.code == "torque_axes"


def test_a_sensor_that_shows_no_weight_is_reported() -> None:
    """The force is the same in every attitude, apart from noise."""
    noise = 0.01 * np.random.default_rng(1).normal(size=(8, 3))
    assert only(replace(RECORDED, force_N=noise)).code == "no_weight"
    unknown = replace(belief(), mass_kg=None, com_m=None)
    assert only(replace(RECORDED, force_N=noise), unknown).code == "no_weight"


@pytest.mark.parametrize("pose", range(8))
def test_a_pose_in_contact_is_left_out_and_named(pose) -> None:
    """One pose of eight in contact is left out; the other poses give the verdict."""
    for number in (0, 1, 10, 30):
        recorded = scaled(wiring=SIGNED[number])
        force = recorded.force_N.copy()
        force[pose] += np.array([3.0, 2.0, -4.0])
        found = judge_installation(replace(recorded, force_N=force), belief())
        assert found.verdict == ("wrong" if number else "right")
        assert f"pose {pose + 1}, left out: contact, or motion" in found.unidentified


def test_unexplained_readings_give_the_comparison_to_make() -> None:
    """Random forces fit no attitudes."""
    rng = np.random.default_rng(2)
    unrelated = replace(RECORDED, force_N=10.0 * rng.normal(size=(8, 3)))
    finding = only(unrelated)
    assert finding.code == "attitude"
    assert "compare the recorded attitudes" in finding.remedy


# --- expected installation ------------------------------------------------------------------------


def test_a_cell_file_gives_the_expected_installation() -> None:
    """It gives mass, lever, mounting and tool; a payload of zero counts as unknown."""
    expected = ExpectedInstallation.of(CELL)
    assert expected.mass_kg == CELL.payload.mass_kg
    assert expected.oat_deg == (30.0, 0.0, 0.0)
    assert expected.p_sensor_tcp_m == pytest.approx([0.0, 0.0, 0.14])
    empty = CELL.payload.model_copy(update={"mass_kg": 0.0, "com_m": (0.0, 0.0, 0.0)})
    unknown = ExpectedInstallation.of(CELL.model_copy(update={"payload": empty}))
    assert unknown.mass_kg is None
    assert unknown.com_m is None


def test_without_a_known_tool_the_axes_are_still_identified() -> None:
    """The readings alone identify a rotated sensor and its angle."""
    payload = Payload(
        mass_kg=2.0,
        com_m=(0.01, 0.02, 0.05),
        bias_force_N=(0.0, 0.0, 0.0),
        bias_torque_Nm=(0.0, 0.0, 0.0),
    )
    turn = oat_matrix((90.0, 0.0, 0.0)).T
    finding = only(readings(payload, force=turn, torque=turn), ExpectedInstallation())
    assert finding.code == "mounting"
    assert "turned by 90 degrees about z" in finding.text

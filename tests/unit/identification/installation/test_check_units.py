"""Installation check: findings of wrong units, payloads and attitudes, with their numbers."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import (
    Array,
    Oat,
    R_from_oat,
    R_from_quaternion,
    oat_from_R,
    quaternion_from_R,
)
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation
from identification.recording import Samples
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


@settings(max_examples=30, deadline=None)
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


@settings(max_examples=30, deadline=None)
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


# --- attitudes and channels -----------------------------------------------------------------------


def with_attitudes(of: Callable[[Array], Array]) -> Samples:
    """Return the readings with each attitude replaced by a function of it."""
    return replace(RECORDED, R_base_sensor=np.array([of(R) for R in RECORDED.R_base_sensor]))


def times(factor: float) -> Samples:
    """Return the readings with O, A and T multiplied by a factor."""
    return with_attitudes(lambda R: R_from_oat(Oat(*(factor * angle for angle in oat_from_R(R)))))


def w_first(R: Array) -> Array:
    """Return the attitude whose quaternion was written with w as the first number."""
    x, y, z, w = quaternion_from_R(R)
    return R_from_quaternion((w, x, y, z))


def with_channel(name: str, axis: int, value_N: float = 0.3) -> Samples:
    """Return the readings with one channel at a constant value."""
    values = getattr(RECORDED, name).copy()
    values[:, axis] = value_N
    return replace(RECORDED, **{name: values})


SWAPPED = replace(RECORDED, force_N=RECORDED.torque_Nm, torque_Nm=RECORDED.force_N)
WALL = readings(PAYLOAD.model_copy(update={"gravity_direction_in_base": (1.0, 0.0, 0.0)}))
NOISE = replace(RECORDED, force_N=0.01 * np.random.default_rng(1).normal(size=(8, 3)))
R_ALL = RECORDED.R_base_sensor
IN_BASE = replace(
    RECORDED,
    force_N=np.einsum("nij,nj->ni", R_ALL, RECORDED.force_N),
    torque_Nm=np.einsum("nij,nj->ni", R_ALL, RECORDED.torque_Nm),
)


@pytest.mark.parametrize(
    ("recorded", "code", "words"),
    [
        (times(np.pi / 180.0), "attitude", "radians are taken for degrees"),
        (times(180.0 / np.pi), "attitude", "degrees taken for radians"),
        (with_attitudes(np.transpose), "attitude", "of the base in the sensor"),
        (with_attitudes(w_first), "attitude", "in the order w x y z"),
        (IN_BASE, "attitude", "in base axes"),
        (SWAPPED, "attitude", "exchanged"),
        (replace(RECORDED, force_N=RECORDED.force_N[::-1]), "attitude", "the recorded attitudes"),
        (WALL, "gravity", "write gravity_direction_in_base: ["),
        (NOISE, "no_weight", "no weight is read"),
        (with_channel("force_N", 1), "gain", "Fy without signal"),
        (with_channel("torque_Nm", 0), "torque_axes", ""),
    ],
)
def test_readings_that_no_wiring_explains_are_reported_with_the_possible_cause(
    recorded: Samples, code: str, words: str
) -> None:
    """Attitudes in a wrong unit or order, base axes, another gravity, a dead channel or sensor."""
    finding = only(recorded)
    assert finding.code == code
    assert words in str(finding)
    assert judge_installation(recorded, belief()).rejection_reason == str(finding)


def test_angles_in_radians_in_the_cell_file_are_recognised() -> None:
    """30 degrees written as 0.5236: the finding names the unit and gives the angles to write."""
    wrong = (0.5236, 0.0, 0.0)
    recorded = readings()
    turned = recorded.R_base_sensor @ oat_matrix((30.0, 0.0, 0.0)).T @ oat_matrix(wrong)
    finding = only(replace(recorded, R_base_sensor=turned), belief(oat_deg=wrong))
    assert "oat_deg [0.5236, 0.0, 0.0] is in radians" in finding.text
    assert finding.remedy == "write sensor.T_flange_sensor.oat_deg: [0, 0, 30]"


@pytest.mark.parametrize("pose", [0, 7])
def test_a_pose_in_contact_is_left_out_and_named(pose) -> None:
    """One pose of eight in contact is left out; the other poses give the verdict."""
    for number in (0, 30):
        recorded = scaled(wiring=SIGNED[number])
        force = recorded.force_N.copy()
        force[pose] += np.array([3.0, 2.0, -4.0])
        found = judge_installation(replace(recorded, force_N=force), belief())
        assert found.verdict == ("wrong" if number else "right")
        assert f"pose {pose + 1}, left out: contact, or motion" in found.unidentified


# --- expected installation ------------------------------------------------------------------------

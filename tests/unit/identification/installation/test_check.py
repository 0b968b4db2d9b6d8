"""Check of the sensor: axes, units and payload from the tool's weight; remedies fix them."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bench.payload import CellErrors
from common.config.payload import Payload
from common.motion.frames import (
    Array,
    Oat,
    R_from_oat,
    R_from_quaternion,
    oat_from_R,
    quaternion_from_R,
)
from identification.installation.axis_fit import EYE, SIGNED, TURNS
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation, InstallationFinding
from identification.recording import Samples
from tests.fakes.installations import ERRORS, PAYLOAD, belief, oat_matrix, readings

CHANNELS = ("all six", "forces", "torques")


@st.composite
def payloads(draw) -> Payload:
    """Draw a payload on the tool's side, off the sensor's axis, with any bias."""
    number = st.floats(-1.0, 1.0)
    off = st.floats(0.01, 0.03) | st.floats(-0.03, -0.01)
    return Payload(
        mass_kg=draw(st.floats(0.5, 6.0)),
        com_m=(draw(off), draw(off), draw(st.floats(0.04, 0.1))),
        bias_force_N=tuple(20.0 * draw(number) for _ in range(3)),
        bias_torque_Nm=tuple(draw(number) for _ in range(3)),
    )


oats = st.tuples(st.floats(-180.0, 180.0), st.floats(5.0, 175.0), st.floats(-180.0, 180.0))


def wired(wiring, channels):
    """Return the axis maps of force and torque when some of the channels have this wiring."""
    return {
        "force": EYE if channels == "torques" else wiring,
        "torque": EYE if channels == "forces" else wiring,
    }


def apply_remedy(
    finding: InstallationFinding, samples: Samples, of: ExpectedInstallation
) -> tuple[Samples, ExpectedInstallation]:
    """Apply the remedy of a finding of axes, word by word, to an arm that stands upright."""
    oat = re.search(r"T_flange_sensor\.oat_deg: \[(.*?)\]", finding.remedy)
    if finding.code == "reaction":
        return replace(samples, force_N=-samples.force_N, torque_Nm=-samples.torque_Nm), of
    if oat:
        x, y, z = (float(angle) for angle in oat[1].split(","))
        R = oat_matrix((x, y, z))
        assert of.R_flange_sensor is not None
        turned = samples.R_base_sensor @ of.R_flange_sensor.T @ R
        # Positions are in flange axes, where they stay; the lever is in those of the sensor.
        com = None if of.com_m is None else R.T @ of.R_flange_sensor @ of.com_m
        corrected = replace(of, R_flange_sensor=R, oat_deg=(x, y, z), com_m=com)
        return replace(samples, R_base_sensor=turned), corrected
    channels = {"F": samples.force_N, "M": samples.torque_Nm}
    after = {name: values.copy() for name, values in channels.items()}
    orders = re.findall(r"([FM])([xyz]) = (-?)[FM]([xyz])", finding.remedy.split(";")[0])
    orders += re.findall(r"(M)([xyz]) = (-?)M([xyz])", finding.remedy.partition("; in")[2])
    assert orders, finding
    for name, axis, sign, source in orders:
        value = channels[name][:, "xyz".index(source)]
        after[name][:, "xyz".index(axis)] = -value if sign else value
    return replace(samples, force_N=after["F"], torque_Nm=after["M"]), of


@pytest.mark.parametrize("channels", CHANNELS)
def test_all_47_wrong_installations_are_identified_and_their_remedies_fix_them(
    channels,
) -> None:
    """In a cell with errors of tilt, gain and drift; the values of each finding correct it."""
    for number, wiring in enumerate(SIGNED):
        recorded = readings(**wired(wiring, channels), world=ERRORS, seed=number, poses=8)
        found = judge_installation(recorded, belief())
        details = f"{channels} {wiring.astype(int).tolist()}: {[str(f) for f in found.findings]}"
        if number == 0:
            assert found.verdict == "right", details
            continue
        assert found.verdict == "wrong", details
        assert len(found.findings) == 1, details
        again = judge_installation(*apply_remedy(found.findings[0], recorded, belief()))
        assert again.verdict == "right", f"{details}, then {[str(f) for f in again.findings]}"


@settings(max_examples=60, deadline=None)
@given(
    payload=payloads(),
    oat_deg=oats,
    wiring=st.integers(0, 47),
    channels=st.sampled_from(CHANNELS),
    poses=st.integers(4, 12),
    seed=st.integers(0, 10**6),
)
@example(  # four poses: two torque wirings, each with its own centre of mass, fit equally well
    payload=Payload(
        mass_kg=1.0,
        com_m=(0.012, -0.03, 0.0625),
        bias_force_N=(0.0, 0.0, 0.0),
        bias_torque_Nm=(0.0, 0.0, 0.0),
    ),
    oat_deg=(0.0, 5.0, 0.0),
    wiring=3,
    channels="torques",
    poses=4,
    seed=48026,
)
def test_any_tool_on_any_mounting_identifies_the_wiring(
    payload, oat_deg, wiring, channels, poses, seed
) -> None:
    """Eight poses are enough for any tool and mounting; fewer never give a wrong verdict."""
    recorded = readings(payload, **wired(SIGNED[wiring], channels), poses=poses, seed=seed)
    expected = belief(payload, oat_deg)
    found = judge_installation(recorded, expected)
    if poses < 8 and found.verdict == "cannot tell":
        assert [finding.code for finding in found.findings] == ["poses"]
        return
    assert found.verdict == ("right" if wiring == 0 else "wrong")
    if wiring == 0:
        return
    assert (
        judge_installation(*apply_remedy(found.findings[0], recorded, expected)).verdict == "right"
    )


@settings(max_examples=30, deadline=None)
@given(payload=payloads(), wiring=st.integers(1, 47), seed=st.integers(0, 10**6))
def test_a_wrong_wiring_is_identified_without_a_known_payload(payload, wiring, seed) -> None:
    """Mass and lever may be unknown: the tool is on the side of its tip."""
    recorded = readings(payload, **wired(SIGNED[wiring], "all six"), seed=seed, poses=9)
    expected = replace(belief(payload), mass_kg=None, com_m=None)
    assert judge_installation(recorded, expected).verdict == "wrong"
    assert judge_installation(readings(payload, seed=seed, poses=9), expected).verdict == "right"


@settings(max_examples=30, deadline=None)
@given(
    turn_deg=st.floats(10.0, 40.0) | st.floats(-40.0, -10.0),
    axis=st.integers(0, 2),
    wiring=st.integers(0, 23),
    seed=st.integers(0, 10**6),
)
def test_a_mounting_angle_is_identified_within_a_degree(turn_deg, axis, wiring, seed) -> None:
    """Angles other than multiples of 90 degrees: the remedy gives the value that corrects it."""
    turn = oat_matrix([(turn_deg, 0.0, 0.0), (0.0, turn_deg, 0.0), (90.0, turn_deg, -90.0)][axis])
    shown = TURNS[wiring] @ turn
    recorded = readings(force=shown, torque=shown, seed=seed, poses=9)
    (finding,) = judge_installation(recorded, belief()).findings
    assert finding.code == "mounting"
    again = judge_installation(*apply_remedy(finding, recorded, belief()))
    assert again.verdict == "right"
    assert again.evidence["turned_deg"] < 1.0


# --- what weight alone cannot determine -----------------------------------------------------------


def with_com(*com_m: float) -> Payload:
    """Return the usual payload with another centre of mass."""
    return PAYLOAD.model_copy(update={"com_m": com_m})


ALONG_Z, NO_LEVER = with_com(0.0, 0.0, 0.055), with_com(0.0, 0.0, 0.0)
LEANING = oat_matrix((4.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("recorded", "expected", "remark"),
    [
        (readings(force=LEANING, torque=LEANING), belief(), "4.0 degrees off"),
        (readings(ALONG_Z), belief(ALONG_Z), "the sign of Mz"),
        (readings(NO_LEVER), replace(belief(NO_LEVER), com_m=None), "the torques, for the tool's"),
        (
            readings(torque=-EYE),
            replace(belief(), com_m=None, p_flange_tcp_m=None),
            "whether the torques are all reversed",
        ),
    ],
)
def test_what_is_not_determined_passes_and_is_reported(recorded, expected, remark) -> None:
    """A mounting error of a few degrees, which a calibration corrects; torques of a short lever."""
    found = judge_installation(recorded, expected)
    assert found.verdict == "right"
    assert any(remark in line for line in found.unidentified)
    assert found.shows_torques == ("off" in remark)


def test_a_sensor_of_reactions_and_a_hanging_arm_give_the_same_readings() -> None:
    """The finding names both; a cell file with the direction of gravity decides."""
    recorded = readings(force=-EYE, torque=-EYE)
    (finding,) = judge_installation(recorded, belief()).findings
    assert finding.code == "reaction"
    assert "push the tool" in finding.remedy
    assert "write gravity_direction_in_base: [0, 0, 1]" in finding.remedy
    hanging = replace(belief(), down_in_base=np.array([0.0, 0.0, 1.0]))
    assert judge_installation(recorded, hanging).verdict == "right"
    assert judge_installation(readings(), hanging).findings[0].code == "reaction"


def test_reversed_torques_are_identified_only_by_the_side_of_the_tool() -> None:
    """-M with -c reads the same as M with c: the known tool or lever decides."""
    recorded = readings(torque=-EYE)
    for known in (belief(), replace(belief(), com_m=None), replace(belief(), p_flange_tcp_m=None)):
        (finding,) = judge_installation(recorded, known).findings
        assert finding.code == "torque_axes"
        assert "torques are all reversed" in finding.text


@pytest.mark.parametrize("oat_deg", [(0.0, 0.0, 0.0), (20.0, 35.0, 50.0)])
@pytest.mark.parametrize(
    "tilts_deg", [range(0, 360, 40), (0, 60, 0, 60, 60, 0, 60, 0, 60), [0] * 9]
)
def test_rotations_about_one_axis_leave_a_mirrored_wiring_possible(oat_deg, tilts_deg) -> None:
    """Gravity stays in one plane, on one line or at one point of the sensor, for any mounting."""
    turns = np.array([oat_matrix((90.0, float(angle), -90.0)) for angle in tilts_deg])
    R = turns @ oat_matrix(oat_deg)
    weight = R.swapaxes(1, 2) @ np.array([0.0, 0.0, -9.8])
    noise = 0.01 * np.random.default_rng(5).normal(size=(9, 3))
    recorded = replace(
        readings(poses=9), R_base_sensor=R, force_N=weight + noise, torque_Nm=0.0 * weight
    )
    found = judge_installation(recorded, belief())
    assert (found.verdict, found.findings[0].code) == ("cannot tell", "poses")
    assert "turn the wrist" in (found.rejection_reason or "")


RECORDED = readings(poses=8, seed=4)


def scaled(force: float = 1.0, torque: float = 1.0) -> Samples:
    """Return readings in other units."""
    return replace(
        RECORDED, force_N=force * RECORDED.force_N, torque_Nm=torque * RECORDED.torque_Nm
    )


def only(recorded: Samples, expected: ExpectedInstallation | None = None):
    """Return the one finding."""
    (finding,) = judge_installation(recorded, expected or belief()).findings
    return finding


@pytest.mark.parametrize(
    ("channel", "factor_of_unit", "words"),
    [
        ("force", 1 / 9.80665, "kilograms-force"),
        ("force", 1 / 4.44822, "pounds-force"),
        ("force", 1e-3, "kilonewtons"),
        ("force", 9.80665, "multiplied by 9.81"),
        ("torque", 1e3, "newton millimetres"),
        ("torque", 8.8507, "inch-pounds"),
        ("torque", 0.10197, "kilogram-force metres"),
    ],
)
def test_a_wrong_unit_is_named(channel: str, factor_of_unit: float, words: str) -> None:
    """The known mass and lever identify it; the mass within a few per cent."""
    recorded = scaled(**{channel: factor_of_unit})
    known = belief()
    for expected in (known, replace(known, mass_kg=0.95, com_m=None)):
        if channel == "force" or expected is known:
            finding = only(recorded, expected)
            assert (finding.code, finding.kind) == (f"{channel}_unit", "installation")
            assert words in finding.text
    if channel == "force":
        factor = float(only(recorded).remedy.split()[4].rstrip(","))
        assert judge_installation(scaled(force=factor_of_unit / factor), known).verdict == "right"


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
        wiring = SIGNED[number]
        recorded = readings(force=wiring, torque=wiring, seed=4)
        force = recorded.force_N.copy()
        force[pose] += np.array([3.0, 2.0, -4.0])
        found = judge_installation(replace(recorded, force_N=force), belief())
        assert found.verdict == ("wrong" if number else "right")
        assert f"pose {pose + 1}, left out: contact, or motion" in found.unidentified


def test_a_light_tool_on_a_drifting_sensor_is_still_judged_correctly() -> None:
    """2 N of drift with a tool of 1.5 N: ten poses in order of time separate the two."""
    payload, drift = PAYLOAD.model_copy(update={"mass_kg": 0.15}), CellErrors(drift=2.0)
    for seed in range(10):
        right = readings(payload, world=drift, seed=seed, poses=10)
        found = judge_installation(right, belief(payload))
        assert found.verdict == "right", [str(f) for f in found.findings]
        W = SIGNED[1 + seed]
        wrong = readings(payload, force=W, torque=W, world=drift, seed=seed, poses=10)
        assert judge_installation(wrong, belief(payload)).verdict != "right"

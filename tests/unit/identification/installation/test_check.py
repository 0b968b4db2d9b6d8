"""Check of the sensor's installation from the tool's weight, with remedies that fix it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bench.payload import CellErrors
from common.config.payload import Payload
from identification.installation.axis_fit import EYE, SIGNED, TURNS
from identification.installation.check import judge_installation
from tests.fakes.installations import ERRORS, PAYLOAD, apply_remedy, belief, oat_matrix, readings

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


def test_a_lever_in_the_axes_of_a_rotated_sensor_is_no_second_finding() -> None:
    """A centre of mass from an earlier calibration of the same rotated sensor: one finding."""
    wiring = TURNS[5]
    recorded = readings(force=wiring, torque=wiring, poses=8)
    expected = replace(belief(), com_m=wiring @ np.array(PAYLOAD.com_m), p_flange_tcp_m=None)
    found = judge_installation(recorded, expected)
    assert [finding.code for finding in found.findings] == ["mounting"]


def test_a_light_tool_on_a_drifting_sensor_is_still_judged_correctly() -> None:
    """2 N of drift with a tool of 1.5 N: ten poses in order of time separate the two."""
    payload = PAYLOAD.model_copy(update={"mass_kg": 0.15})
    for seed in range(10):
        right = readings(payload, world=CellErrors(drift=2.0), seed=seed, poses=10)
        found = judge_installation(right, belief(payload))
        assert found.verdict == "right", [str(f) for f in found.findings]
        W = SIGNED[1 + seed]
        wrong = readings(
            payload, force=W, torque=W, world=CellErrors(drift=2.0), seed=seed, poses=10
        )
        assert judge_installation(wrong, belief(payload)).verdict != "right"

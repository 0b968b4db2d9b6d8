"""Payload identification: refusals, choice of the wrench axes, and the payload file."""

import numpy as np
import pytest
from hypothesis import given, settings

from bench.payload import CellErrors, attitudes, truth
from common.config.payload import BiasDrift, load, save
from common.motion.frames import rotation_from_vector
from forcemesh.errors import DataError
from identification.identify import axes_of, identify_payload, identify_recording
from identification.recording import Samples
from tests.fakes.weights import QUICK, TRUTH, as_recording, readings, seeds


def about(axis, angles):
    """Return rotations about one axis."""
    return [rotation_from_vector(angle * np.array(axis)) for angle in angles]


FLIPPED = [np.eye(3), np.diag([1.0, -1.0, -1.0])]


@pytest.mark.parametrize(
    ("attitudes_of_poses", "problem"),
    [
        (about((1.0, 0.0, 0.0), (0.0, 1.0, 2.0)), r"only 3 distinct pose.*two axes"),
        (
            about((1.0, 0.0, 0.0), (-0.07, 0.07)) + about((0.0, 1.0, 0.0), (-0.07, 0.07)),
            r"differ by only 8 degrees.*at least 60 degrees",
        ),
        (about((0.0, 0.0, 1.0), np.arange(0.0, 3.0, 0.5)), "turns about the vertical"),
        (
            [turn @ flip for turn in about((0.0, 0.0, 1.0), (0.0, 1.0, 2.0)) for flip in FLIPPED],
            "about one axis only",
        ),
    ],
)
def test_poses_that_cannot_separate_weight_from_bias_are_refused(
    attitudes_of_poses, problem
) -> None:
    """Too few, too close, about the vertical only, or with two directions of gravity."""
    with pytest.raises(DataError, match=problem):
        identify_payload(readings(TRUTH, np.array(attitudes_of_poses)))


def test_a_recording_without_weight_is_refused() -> None:
    """Constant readings show a bias but no payload."""
    R = attitudes(np.random.default_rng(9), 8)
    with pytest.raises(DataError, match="shows no weight"):
        identify_payload(Samples(R, np.ones((8, 3)), np.ones((8, 3))))


@settings(QUICK, max_examples=3)
@given(seed=seeds)
def test_both_wrench_axes_give_the_same_payload(seed) -> None:
    """The same readings in sensor axes and in base axes fit alike; auto identifies them.

    Two poses are enough where the payload is known; others are used as requested, with a warning.
    """
    rng = np.random.default_rng(seed)
    samples = readings(TRUTH, attitudes(rng, 10), rng)
    fits = [identify_recording(as_recording(samples, axes), None) for axes in ("sensor", "base")]
    assert [fit.axes for fit in fits] == ["sensor", "base"]
    a, b = (fit.identification.payload for fit in fits)
    np.testing.assert_allclose(a.com_m, b.com_m, atol=1e-6)
    np.testing.assert_allclose(a.bias_force_N, b.bias_force_N, atol=1e-5)
    assert axes_of(as_recording(samples[:2], "base"), TRUTH)[0] == "base"
    wrong = identify_recording(as_recording(samples, "base"), "sensor")
    assert wrong.axes == "sensor"
    assert "use --wrench-axes base" in wrong.identification.warnings[0]


def test_ambiguous_axes_are_refused_with_the_option_to_use() -> None:
    """With the sensor parallel to the base both axes are the same."""
    recording = as_recording(readings(TRUTH, np.eye(3)[None]), "sensor")
    with pytest.raises(DataError, match="use --wrench-axes"):
        axes_of(recording, TRUTH)


GOOD = """mass_kg: 1e-1
com_m: [0, 0, 0.1]
bias_force_N: [0, 0, 0]
bias_torque_Nm: [0, 0, 0]
"""


def test_a_payload_file_round_trips_and_may_leave_out_the_corrections(tmp_path) -> None:
    """With tilt, mounting, gain, and the clock of the drift; gravity points down by default."""
    drift = BiasDrift(
        start_s=10.0, end_s=70.0, force_N=(1.0, 0.0, -2.0), torque_Nm=(0.1, 0.0, 0.0),
        force_bend_N=(0.2, 0.0, 0.0),
    )  # fmt: skip
    errors = truth(CellErrors(3.0, 5.0, 1.0), np.random.default_rng(12))
    payload = errors.model_copy(update={"drift": drift})
    path = tmp_path / "payload.yaml"
    save(payload, path)
    assert load(path) == payload
    path.write_text(GOOD)
    by_hand = load(path)
    assert (by_hand.mass_kg, by_hand.drift) == (0.1, None)
    assert by_hand.gravity_direction_in_base == (0.0, 0.0, -1.0)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (GOOD.replace("1e-1", ".nan"), "mass_kg: must be a finite number, found nan"),
        (GOOD.replace("1e-1", "-1"), "mass_kg: must be at least 0 kg, found -1 kg"),
        (GOOD.replace("com_m", "com_mm"), r"unknown key com_mm; did you mean com_m\?"),
        (GOOD + "gravity_direction_in_base: [0, 0, -9.8]\n", "direction has length 9.8"),
        (GOOD + "force_gain: [1, 1, 3]\n", r"force_gain\.2: must be at most 1\.5, found 3"),
        (
            GOOD + "drift: {start_s: 9, end_s: 9, force_N: [0, 0, 0], torque_Nm: [0, 0, 0]}\n",
            "end_s must be after start_s",
        ),
        ("- 1\n", "must hold the keys of a payload"),
    ],
)
def test_a_bad_payload_file_gets_one_error_with_file_and_key(tmp_path, text, problem) -> None:
    """Each error names the file, the key and the correct form."""
    path = tmp_path / "payload.yaml"
    path.write_text(text)
    with pytest.raises(DataError, match=rf"payload\.yaml.*{problem}"):
        load(path)

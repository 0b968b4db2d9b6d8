"""`forcemesh payload`: output streams, keys of its JSON, exit codes."""

import json
from functools import partial

import numpy as np
import pytest

from common.config.payload import Payload
from forcemesh.yaml_file import read_model
from tests.fakes import verb_calls
from tests.fakes.weights import TRUTH, drawn, write_recording

run = partial(verb_calls.run, "payload")


@pytest.mark.parametrize("axes", ["sensor", "base"])
def test_fit_prints_one_json_object_and_its_remarks_on_stderr(tmp_path, axes) -> None:
    """Standard output is only JSON: each number with its deviation, each row that was left out."""
    samples = drawn(poses=12)
    samples.force_N[3] += 20.0
    result = run("fit", write_recording(tmp_path / "a.csv", samples, axes), "--json")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert (report["wrench_axes"], report["model"], report["poses"]) == (axes, "plain", 11)
    assert f"wrench taken to be in {axes} axes: rms residual" in result.stderr
    assert report["mass_kg"] == pytest.approx(1.5, abs=0.01)
    assert report["com_m"] == pytest.approx(TRUTH.com_m, abs=0.001)
    assert report["bias_force_N"] == pytest.approx(TRUTH.bias_force_N, abs=0.05)
    assert report["bias_torque_Nm"] == pytest.approx(TRUTH.bias_torque_Nm, abs=0.005)
    assert 0.0 < report["mass_std_kg"] < 0.01
    assert len(report["com_std_m"]) == len(report["bias_force_std_N"]) == 3
    assert 1.0 <= report["conditioning"] < 10.0
    assert 0.0 < report["residual_force_N_mean"] <= report["residual_force_N_max"] < 0.1
    assert report["leave_one_out_force_N"] > report["rms_force_N"] > 0.0
    assert [row["lines"] for row in report["rejected"]] == [[5]]
    assert "in contact" in report["rejected"][0]["reason"]
    assert [row["line"] for row in report["residuals"]] == [2, 3, 4, *range(6, 14)]
    assert [each["name"] for each in report["models"] if each["used"]] == ["plain"]
    assert len(report["next_pose"]["quaternion"]) == 4


def test_fit_warns_of_a_sensor_with_axes_that_contradict_the_poses(tmp_path) -> None:
    """Rotated or mirrored axes give a warning for any residual; correct ones give none."""
    mirrored, turned = np.diag([-1.0, 1.0, 1.0]), np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    for wired, warning in (
        (mirrored, "gravity points up"),
        (turned, "turned by 90 degrees about z"),
        (np.eye(3), ""),
    ):
        samples = drawn()
        samples.force_N[:], samples.torque_Nm[:] = (
            samples.force_N @ wired.T,
            samples.torque_Nm @ wired.T,
        )
        path = write_recording(tmp_path / "a.csv", samples)
        result = run("fit", path, "--wrench-axes=sensor")
        assert result.exit_code == 0
        assert warning in result.stderr
        assert ("warning: " in result.stderr) == bool(warning)


def test_a_fitted_payload_is_checked_on_another_recording(tmp_path) -> None:
    """On attitudes outside the fit, in other axes; half a kilogram more appears as its weight."""
    out = tmp_path / "payload.yaml"
    path = write_recording(tmp_path / "a.csv", drawn())
    assert run("fit", path, "--out", out).exit_code == 0
    assert read_model(Payload, out).mass_kg == pytest.approx(1.5, abs=0.01)
    other = write_recording(tmp_path / "b.csv", drawn(1), "base")
    report = json.loads(run("check", other, "--payload", out, "--json").stdout)
    assert report["wrench_axes"] == "base"
    assert 0.0 < report["residual_force_N_mean"] <= report["residual_force_N_max"] < 0.1
    assert 0.0 < report["residual_torque_Nm_mean"] <= report["residual_torque_Nm_max"] < 0.01
    heavy = TRUTH.model_copy(update={"mass_kg": 2.0})
    path = write_recording(tmp_path / "c.csv", drawn(payload=heavy))
    words = ("check", path, "--payload", out, "--wrench-axes", "sensor")
    report = json.loads(run(*words, "--json").stdout)
    assert report["residual_force_N_mean"] == pytest.approx(0.5 * 9.80665, rel=0.02)
    assert "line of the max" in run(*words).stdout

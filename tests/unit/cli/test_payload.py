"""`forcemesh payload`: output streams, keys of its JSON, exit codes."""

import json
from functools import partial

import numpy as np
import pytest

from common.config.payload import BiasDrift, Payload, load
from tests.fakes import verb_calls
from tests.fakes.payload_csv import write_recording
from tests.fakes.weights import TRUTH

run = partial(verb_calls.run, "payload")


@pytest.mark.parametrize("axes", ["sensor", "base"])
def test_fit_prints_one_json_object_and_its_remarks_on_stderr(tmp_path, axes):
    """Standard output is only JSON; the chosen axes and the reason go to standard error."""
    result = run("fit", write_recording(tmp_path / "a.csv", axes=axes), "--json")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert report["wrench_axes"] == axes
    assert f"wrench taken to be in {axes} axes: rms residual" in result.stderr
    assert report["model"] == "plain"
    assert report["mass_kg"] == pytest.approx(1.5, abs=0.01)
    assert report["com_m"] == pytest.approx(TRUTH.com_m, abs=0.001)
    assert report["bias_force_N"] == pytest.approx(TRUTH.bias_force_N, abs=0.05)
    assert report["bias_torque_Nm"] == pytest.approx(TRUTH.bias_torque_Nm, abs=0.005)
    assert 0.0 < report["mass_std_kg"] < 0.01
    assert len(report["com_std_m"]) == len(report["bias_force_std_N"]) == 3
    assert 1.0 <= report["conditioning"] < 10.0
    assert 0.0 < report["residual_force_N_mean"] <= report["residual_force_N_max"] < 0.1
    assert report["leave_one_out_force_N"] > report["rms_force_N"] > 0.0
    assert [row["line"] for row in report["residuals"]] == list(range(2, 12))
    assert report["models"][0]["verdict"] == "used"


def test_fit_warns_of_a_sensor_with_axes_that_contradict_the_poses(tmp_path):
    """Rotated or mirrored axes give a warning for any residual; correct ones give none."""
    mirrored, turned = np.diag([-1.0, 1.0, 1.0]), np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    for wired, warning in (
        (mirrored, "gravity points up"),
        (turned, "turned by 90 degrees about z"),
    ):
        bad = run("fit", write_recording(tmp_path / "a.csv", wired=wired), "--wrench-axes=sensor")
        assert bad.exit_code == 0
        assert "warning: " in bad.stderr
        assert warning in bad.stderr
    good = run("fit", write_recording(tmp_path / "b.csv"), "--wrench-axes=sensor")
    assert good.stderr == ""


def test_a_fitted_payload_explains_another_recording(tmp_path):
    """After fit --out, check works on attitudes outside the fit, in other axes."""
    out = tmp_path / "payload.yaml"
    assert run("fit", write_recording(tmp_path / "a.csv"), "--out", out).exit_code == 0
    assert load(out).mass_kg == pytest.approx(1.5, abs=0.01)
    other = write_recording(tmp_path / "b.csv", axes="base", seed=1)
    result = run("check", other, "--payload", out, "--json")
    report = json.loads(result.stdout)
    assert result.exit_code == 0
    assert report["wrench_axes"] == "base"
    assert 0.0 < report["residual_force_N_mean"] <= report["residual_force_N_max"] < 0.1
    assert 0.0 < report["residual_torque_Nm_mean"] <= report["residual_torque_Nm_max"] < 0.01
    wrong = run("check", other, "--payload", out, "--wrench-axes", "sensor", "--json")
    assert "use --wrench-axes base" in wrong.stderr


def test_check_follows_the_drift_through_the_time_of_each_row(tmp_path):
    """Rows of the fit's period are explained with the drift; later ones with its end value."""
    drift = BiasDrift(
        start_s=0.0, end_s=90.0, force_N=(3.0, -2.0, 1.0), torque_Nm=(0.1, -0.05, 0.05)
    )
    drifting, out = TRUTH.model_copy(update={"drift": drift}), tmp_path / "payload.yaml"
    fit = run("fit", write_recording(tmp_path / "a.csv", payload=drifting), "--out", out, "--json")
    assert json.loads(fit.stdout)["model"] == "drift"
    same = write_recording(tmp_path / "b.csv", payload=drifting, seed=1, start_s=5.0)
    later = write_recording(tmp_path / "c.csv", seed=2, start_s=1e6)
    for path, used in ((same, "used"), (later, "of another time, not used")):
        report = json.loads(run("check", path, "--payload", out, "--json").stdout)
        assert report["drift"] == used
        assert report["residual_force_N_mean"] < 0.06
    assert "without it" in run("check", same, "--payload", out).stdout


def test_fit_lists_every_parameter_the_rejected_rows_and_the_next_pose(tmp_path):
    """The JSON report has each number with its deviation, and each rejected row with its reason."""
    path = write_recording(tmp_path / "a.csv", poses=12)
    lines = path.read_text().splitlines()
    cells = lines[4].split(",")
    cells[8] = str(float(cells[8]) + 20.0)
    lines[4] = ",".join(cells)
    path.write_text("\n".join(lines))
    result = run("fit", path, "--json", "--wrench-axes", "sensor")
    report = json.loads(result.stdout)
    assert [r["lines"] for r in report["rejected"]] == [[5]]
    assert "in contact" in report["rejected"][0]["reason"]
    assert report["poses"] == 11
    names = [p["name"] for p in report["parameters"]]
    assert names[0] == "mass_kg"
    assert len(names) == 10
    assert all(p["std"] > 0.0 and p["amplified"] >= 0.999 for p in report["parameters"])
    assert len(report["next_pose"]["quaternion"]) == 4
    shown = run("fit", path, "--wrench-axes", "sensor").stdout
    assert "rejected 1 rows: in contact" in shown
    assert "record next: gravity along" in shown


def test_check_shows_that_the_payload_has_changed(tmp_path):
    """Half a kilogram more appears as its weight, and the table gives the line."""
    out = tmp_path / "payload.yaml"
    run("fit", write_recording(tmp_path / "a.csv"), "--out", out)
    heavy = Payload(
        mass_kg=2.0,
        com_m=TRUTH.com_m,
        bias_force_N=TRUTH.bias_force_N,
        bias_torque_Nm=TRUTH.bias_torque_Nm,
    )
    other = write_recording(tmp_path / "b.csv", payload=heavy)
    report = json.loads(
        run("check", other, "--payload", out, "--wrench-axes", "sensor", "--json").stdout
    )
    assert report["residual_force_N_mean"] == pytest.approx(0.5 * 9.80665, rel=0.02)
    assert "line of the max" in run("check", other, "--payload", out).stdout

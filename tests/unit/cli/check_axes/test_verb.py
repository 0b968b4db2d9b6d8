"""`forcemesh check axes --from`: verdict, sentences, JSON, exit codes; usage in one sentence."""

import json
from functools import partial

import pytest

from identification.installation.axis_fit import SIGNED
from tests.fakes import verb_calls
from tests.fakes.bench import DEMO
from tests.fakes.installations import recorded

run = partial(verb_calls.run, "check", "axes", "--cell", DEMO)


@pytest.mark.parametrize("axes", ["sensor", "base"])
def test_a_right_recording_ends_with_zero(tmp_path, axes) -> None:
    """The axes of the recording are identified and printed."""
    result = run("--from", recorded(tmp_path / "a.csv", wrench_axes=axes))
    assert result.exit_code == 0, result.output
    assert "right: axes, signs and units are those of the cell file" in result.stdout
    assert f"in {axes} axes" in result.stdout


def test_a_wrong_recording_gives_the_finding_and_the_remedy(tmp_path) -> None:
    """Exit code 1, the finding, and the remedy below it."""
    result = run("--from", recorded(tmp_path / "a.csv", SIGNED[2]))
    assert result.exit_code == 1
    assert "Fy shows -y" in result.stdout
    assert "-> in the driver or the adapter: remap Fy = -Fy" in result.stdout


def test_json_is_one_object_with_the_numbers(tmp_path) -> None:
    """Verdict, findings with code and remedy, wiring, evidence."""
    result = run("--from", recorded(tmp_path / "a.csv", SIGNED[18]), "--json")
    tree = json.loads(result.stdout)
    assert tree["verdict"] == "wrong"
    assert tree["findings"][0]["code"] == "mounting"
    assert tree["findings"][0]["remedy"].startswith("write sensor.T_flange_sensor.oat_deg: [")
    assert tree["force_channels_show"] == SIGNED[18].tolist()
    assert tree["evidence"]["poses"] == 8

"""`forcemesh check axes --from`: verdict, sentences, JSON, exit codes; usage in one sentence."""

import json
from functools import partial

import pytest

from identification.installation.axis_fit import SIGNED
from tests.fakes import verb_calls
from tests.fakes.bench import DEMO
from tests.fakes.installations import recorded

run = partial(verb_calls.run, "check", "axes", "--cell", DEMO)


@pytest.mark.parametrize("base_axes", [False, True])
def test_a_right_recording_ends_with_zero(tmp_path, base_axes) -> None:
    """The axes of the recording are identified and printed."""
    result = run("--from", recorded(tmp_path / "a.csv", base_axes=base_axes))
    assert result.exit_code == 0, result.output
    assert "right: axes, signs and units are those of the cell file" in result.stdout
    assert f"in {'base' if base_axes else 'sensor'} axes" in result.stdout


def test_a_wrong_recording_gives_the_finding_and_the_remedy(tmp_path) -> None:
    """Exit code 1, the finding, and the remedy below it."""
    result = run("--from", recorded(tmp_path / "a.csv", SIGNED[2]))
    assert result.exit_code == 1
    assert "Fy shows -y" in result.stdout
    assert "-> in the driver or the adapter: remap Fy = -Fy" in result.stdout


def test_every_wiring_of_a_recording_gets_its_verdict(tmp_path) -> None:
    """The chain from file to verdict: 1 right, 47 wrong."""
    codes = [run("--from", recorded(tmp_path / "a.csv", W)).exit_code for W in SIGNED]
    assert codes == [0] + [1] * 47


def test_json_is_one_object_with_the_numbers(tmp_path) -> None:
    """Verdict, findings with code and remedy, wiring, evidence."""
    result = run("--from", recorded(tmp_path / "a.csv", SIGNED[18]), "--json")
    tree = json.loads(result.stdout)
    assert tree["verdict"] == "wrong"
    assert tree["findings"][0]["code"] == "mounting"
    assert tree["findings"][0]["remedy"].startswith("write sensor.T_flange_sensor.oat_deg: [")
    assert tree["force_channels_show"] == SIGNED[18].tolist()
    assert tree["evidence"]["poses"] == 8


def test_the_mass_option_overrides_the_cell_file(tmp_path) -> None:
    """Readings ten times too small are newtons of a light tool or kgf of the given mass."""
    path = recorded(tmp_path / "a.csv", times=1 / 9.80665)
    assert "kilograms-force" in run("--from", path, "--mass", "1.0").stdout
    assert "kilograms-force" not in run("--from", path, "--mass", "0.102").stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--push", "--from", "a.csv"), "--push and --from cannot be combined"),
        (("--wrench-axes", "base"), "--wrench-axes requires --from"),
    ],
)
def test_options_that_exclude_each_other_are_refused(arguments, words) -> None:
    """One sentence, exit code 2."""
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr


def test_a_missing_recording_ends_with_one_line() -> None:
    """There is neither a traceback nor a verdict."""
    result = run("--from", "nowhere.csv")
    assert result.exit_code == 2
    assert "nowhere.csv" in result.stderr
    assert len(result.stderr.splitlines()) == 1

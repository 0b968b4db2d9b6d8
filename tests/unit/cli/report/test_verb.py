"""Verb `report` on logs of other robots: page, summary, JSON, and refusals."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.context import OK, USAGE
from tests.fakes.force_logs import (
    WRENCH_STAMPED,
    first_order,
    noise,
    press_csv,
    second_order,
    setpoint_at,
    times,
    wrench_cdr,
    write_csv,
    write_mcap,
)

TAU_S = 0.05


def run(*words: object) -> tuple[int, str, str]:
    """Run `report`; return exit code, standard output and error."""
    result = CliRunner().invoke(app, ["report", *(str(word) for word in words)])
    return result.exit_code, result.stdout, result.stderr


def judged(path: Path, *options: object) -> dict[str, Any]:
    """Return what `report --json` prints."""
    code, out, error = run(path, *options, "--json", "-o", path.with_suffix(".page.html"))
    assert code == OK, error
    found: dict[str, Any] = json.loads(out)
    return found


def test_a_log_of_any_robot_becomes_a_page_and_a_summary(tmp_path: Path) -> None:
    """Without an option: the columns are found by their names, which is noted in both.

    JSON has the figures: a band in newtons and single samples are options.
    """
    code, out, error = run(press_csv(tmp_path / "press.csv"))
    assert (code, error) == (OK, "")
    assert out.startswith("press.csv: 5.0 s, 2500 samples, 500 per s; judged: fz [N]\n")
    assert "0\u00a0→\u00a010" in out
    assert "no findings" in out
    assert "note: fz is judged, because it changes most; --axis names another" in out
    page = (tmp_path / "press.html").read_text(encoding="utf-8")
    for part in ("Force log press.csv", "Segments", "Definitions", "± 5 % of the step", "1 of 1"):
        assert part in page
    assert page.count("<img") == 3
    assert "http" not in page.replace("http://www.w3.org", "")
    tree = judged(tmp_path / "press.csv", "--band", "1N", "--mean-ms", 0)
    before, after = tree["segments"]
    assert (before["settled"], before["settling_s"], before["target"]) == (None, None, None)
    assert after["settling_s"] == pytest.approx(TAU_S * math.log(10.0), abs=0.012)
    assert (tree["axis"], tree["unit"], tree["findings"]) == ("fz", "N", [])
    assert tree["band"] == {"value": 1.0, "unit": "N"}
    assert [column["name"] for column in tree["columns"]] == ["fx", "fy", "fz"]


def test_a_log_with_faults_has_them_on_the_page_and_in_the_summary(tmp_path: Path) -> None:
    """Clipping, an oscillation, a gap, missing values, a dead channel."""
    time_s = times()
    force = 20.0 * second_order(time_s, damping=0.3, rad_s=20.0) + noise(2500, 0.05)
    force += (
        0.5
        * setpoint_at(time_s, 1.0)
        * (time_s > 2.0)
        * second_order(time_s - 2.0, damping=0.001, rad_s=150.0, at_s=0.0)
    )
    rows = [number for number in range(2500) if not 1000 <= number < 1050]
    columns: dict[str, list[object]] = {
        "t": [time_s[number] for number in rows],
        "fx": ["" if number < 3 else 0.25 for number in rows],
        "fz": [min(force[number], 24.0) for number in rows],
    }
    code, out, _ = run(write_csv(tmp_path / "log.csv", columns), "--setpoint", 20)
    page = (tmp_path / "log.html").read_text(encoding="utf-8")
    assert code == OK
    sentences = ("gaps in the samples: 1", "overshoot", "is an oscillation of 23.9 Hz")
    for sentence in (
        *sentences,
        "fx never changes",
        "fx has no value in 3 rows",
        "is flat at 24 N",
    ):
        assert sentence in out
        assert sentence in page


def test_a_rosbag_is_judged_by_the_stamps_of_its_messages(tmp_path: Path) -> None:
    """WrenchStamped of ROS 2, beside another topic; the times of the file are late and uneven."""
    force = 10.0 * first_order(times(), TAU_S) + noise(2500, 0.02)
    late = noise(2500, 0.0002) + 0.01
    wrenches = [
        (at + delay, wrench_cdr(at, (0.0, 0.0, each, 0.0, 0.0, 0.0), frame="ft"))
        for at, each, delay in zip(times() + 100.0, force, late, strict=True)
    ]
    topics = {
        ("/joints", "sensor_msgs/msg/JointState", "cdr"): [(100.0, b"\0" * 8)],
        ("/ft/wrench", WRENCH_STAMPED, "cdr"): wrenches,
    }
    path = write_mcap(tmp_path / "bag.mcap", topics)
    tree = judged(path, "--setpoint", 10)
    assert tree["segments"][1]["settling_s"] == pytest.approx(TAU_S * math.log(20.0), abs=0.015)
    assert tree["notes"][:2] == [
        "the topic is /ft/wrench, the only one that can be read",
        "time is column 'stamp_s', by its name",
    ]
    assert tree["sampling"]["largest_jitter_s"] < 1e-6
    assert judged(path, "--time", "log_time_s")["sampling"]["largest_jitter_s"] > 1e-4


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--band", "wide"), "--band 'wide': must be a positive number with % or a unit"),
        (("--axis", "f"), "--axis 'f' is no force or torque of the log"),
        (("-o", "{}"), "is the file that is read: choose another name"),
        (("-o", "/proc/none"), "/proc/none: cannot be written"),
    ],
)
def test_every_mistake_is_one_sentence(
    tmp_path: Path, options: tuple[str, ...], sentence: str
) -> None:
    """With exit code 2, without a page."""
    path = press_csv(tmp_path / "press.csv")
    code, out, error = run(path, *(option.replace("{}", str(path)) for option in options))
    assert (code, out) == (USAGE, "")
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "press.html").exists()

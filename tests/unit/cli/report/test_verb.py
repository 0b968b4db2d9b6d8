"""Verb `report`: logs of other robots as CSV and MCAP, with page, summary and JSON."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.context import OK
from cli.report.log_mcap import McapTable
from cli.report.log_table import read_numbers
from forcemesh.errors import DataError
from tests.fakes import verb_calls
from tests.fakes.force_logs import (
    WRENCH_STAMPED,
    first_order,
    noise,
    setpoint_at,
    times,
    wrench_cdr,
    write_csv,
    write_mcap,
)

TAU_S = 0.05


def run(*words: object) -> tuple[int, str, str]:
    """Run `report`; return exit code, standard output and error."""
    done = verb_calls.run("report", *words)
    return done.exit_code, done.stdout, done.stderr


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
    time_s = times()
    force = 10.0 * first_order(time_s, TAU_S) + noise(len(time_s), 0.02)
    columns = {"t": time_s, "fx": noise(len(time_s), 0.02, 2), "fz": force}
    aimed = {"setpoint": setpoint_at(time_s, 10.0)}
    code, out, error = run(write_csv(tmp_path / "press.csv", columns | aimed))
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
    assert [column["name"] for column in tree["columns"]] == ["fx", "fz"]


FORCES = ("wrench.force.x", "wrench.force.y", "wrench.force.z")
TORQUES = ("wrench.torque.x", "wrench.torque.y", "wrench.torque.z")
numbers = st.floats(-1e30, 1e30)


@given(six=st.tuples(*[numbers] * 6), frame=st.text("abc_", max_size=20), big=st.booleans())
def test_a_wrench_in_cdr_is_read_to_the_last_digit(
    six: tuple[float, ...], frame: str, big: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Whatever the length of the frame's name, which moves the alignment, and the byte order.

    A geometry_msgs/Wrench has no stamp: its time is that of the file.
    """
    path = tmp_path_factory.mktemp("bag") / "log.mcap"
    data = wrench_cdr(7.25, six, frame=frame, order=">" if big else "<")
    write_mcap(path, {("/ft", WRENCH_STAMPED, "cdr"): [(9.0, data)]})
    found = read_numbers(McapTable(path, None), ("stamp_s", "log_time_s", *FORCES, *TORQUES))
    assert [found[name][0] for name in (*FORCES, *TORQUES)] == list(six)
    assert (found["stamp_s"][0], found["log_time_s"][0]) == (7.25, 9.0)
    bare = data[:4] + data[-48:]
    write_mcap(path, {("/ft", "geometry_msgs/Wrench", "cdr"): [(9.0, bare)]})
    table = McapTable(path, None)
    assert table.time_names == ("log_time_s",)
    assert read_numbers(table, ("force.z",))["force.z"].tolist() == [six[2]]


def test_json_fields_are_joined_by_dots_and_stamped(tmp_path: Path) -> None:
    """Times are those of the message's header where it has one; a missing field is missing."""
    trees = [
        {"header": {"stamp": {"sec": 5, "nanosec": 500_000_000}}, "wrench": {"force": {"z": 2.0}}},
        {"header": {"stamp": {"sec": 6, "nanosec": 0}}, "wrench": {"force": {}}, "note": "x"},
    ]
    messages = [(float(at), json.dumps(tree).encode()) for at, tree in enumerate(trees, 10)]
    table = McapTable(write_mcap(tmp_path / "a.mcap", {("/ft", "W", "json"): messages}), None)
    assert table.time_names[0] == "stamp_s"
    found = read_numbers(table, ("stamp_s", "wrench.force.z"))
    assert found["stamp_s"].tolist() == [5.5, 6.0]
    assert found["wrench.force.z"][0] == 2.0
    assert str(found["wrench.force.z"][1]) == "nan"
    with pytest.raises(DataError, match=r"message 2, column 'note': 'x' is not a number within"):
        read_numbers(table, ("note",))


@pytest.mark.parametrize(
    ("schema", "encoding", "data", "sentence"),
    [
        (WRENCH_STAMPED, "ros1", b"", "topic /ft is geometry_msgs/msg/WrenchStamped, ros1 and"),
        ("foxglove.Pose", "protobuf", b"", "cannot be read: read are JSON and"),
        ("", "", b"", "topic /ft is no schema, no encoding and cannot be read"),
        (WRENCH_STAMPED, "cdr", b"\0\1\0\0\0", "message 1 cannot be decoded"),
        (WRENCH_STAMPED, "cdr", b"\0", "message 1 cannot be decoded: it is shorter"),
        ("W", "json", b"{", "message 1 cannot be decoded"),
        ("W", "json", b"{}", "topic /ft has no message with fields"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_kind(
    tmp_path: Path, schema: str, encoding: str, data: bytes, sentence: str
) -> None:
    """And with the conversion."""
    path = write_mcap(tmp_path / "a.mcap", {("/ft", schema, encoding): [(1.0, data)]})
    with pytest.raises(DataError, match=r"a\.mcap: ") as raised:
        McapTable(path, "/ft")
    assert sentence in str(raised.value)


def test_an_unknown_topic_is_refused_and_a_truncated_file_is_read_up_to_its_end(
    tmp_path: Path,
) -> None:
    """The message lists the topics with schema and encoding; the note comes once."""
    rows = 40_000
    messages = [(float(k), json.dumps({"t": k, "fz": k}).encode()) for k in range(rows)]
    path = write_mcap(tmp_path / "a.mcap", {("/ft", "W", "json"): messages})
    with pytest.raises(DataError, match=r"topic '/f' is missing; the topics are: /ft \(W, json\)"):
        McapTable(path, "/f")
    path.write_bytes(path.read_bytes()[:500_000])
    table = McapTable(path, None)
    assert 1000 < len(read_numbers(table, ("fz",))["fz"]) < rows
    assert table.notes == ["the file is truncated: read up to its end"]

"""MCAP files of other programs: JSON and WrenchStamped, and everything that is refused."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.report.log_mcap import McapTable
from cli.report.log_table import read_numbers
from forcemesh.errors import DataError
from tests.fakes.force_logs import WRENCH_STAMPED, json_messages, wrench_cdr, write_mcap

JSON = {"t": [10.0, 10.5, 11.0], "fz": [1.0, 2.0, 3.0]}
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
    messages = json_messages({"t": range(rows), "fz": range(rows)})
    path = write_mcap(tmp_path / "a.mcap", {("/ft", "W", "json"): messages})
    with pytest.raises(DataError, match=r"topic '/f' is missing; the topics are: /ft \(W, json\)"):
        McapTable(path, "/f")
    path.write_bytes(path.read_bytes()[:500_000])
    table = McapTable(path, None)
    assert 1000 < len(read_numbers(table, ("fz",))["fz"]) < rows
    assert table.notes == ["the file is truncated: read up to its end"]

"""Recordings of older schema versions open as those of today do.

tests/corpus/messages-version-N.json holds one message of each topic as the last program of version
N encoded it, recording-version-2.mcap what its recorder wrote.
"""

import base64
import json
import re
from pathlib import Path
from typing import Any

import msgpack
import pytest

from common.config.load import load_cell
from forcemesh.clock import ManualClock
from forcemesh.codec import SCHEMA_VERSION, decode, pack, unpack
from forcemesh.errors import MessageError, MisroutedError
from forcemesh.messages import Permission, RegulatorTarget, RobotState
from forcemesh.recorded_messages import READABLE_VERSIONS, decode_recorded, readdressed
from forcemesh.topics import TOPICS
from launch.virtual_cell import VirtualCell
from services.recorder.reading import RecordedFile, play
from tests.fakes.verb_calls import run

CORPUS = Path(__file__).resolve().parents[2] / "corpus"
DEMO = Path(__file__).resolve().parents[3] / "cells" / "demo.yaml"
KEPT: dict[tuple[int, str], bytes] = {
    (version, key): base64.b64decode(data)
    for version in (1, 2)
    for key, data in json.loads((CORPUS / f"messages-version-{version}.json").read_text()).items()
}
BY_KEY: dict[str, Any] = {topic.key: topic for topic in TOPICS}
each_kept = pytest.mark.parametrize(("version", "key"), KEPT)


OLD = CORPUS / "recording-version-2.mcap"  # an arm that is armed, presses and is held


def as_written(read: Any, written: Any) -> Any:
    """Return a read record without the fields that records got since: they have their defaults."""
    if isinstance(read, dict) and isinstance(written, dict) and written.keys() <= read.keys():
        return {name: as_written(read[name], written[name]) for name in written}
    if isinstance(read, tuple) and isinstance(written, tuple) and len(read) == len(written):
        return tuple(as_written(*pair) for pair in zip(read, written, strict=True))
    return read


# Where the fields that version 3 has changed are now, by topic: old path, new path.
MOVED: dict[str, list[tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "robot/state": [
        (("status", "motor_power"), ("status", "kawasaki", "motor_power")),
        (("status", "moving"), ("status", "moving")),
        (("status", "held"), ("status", "held")),
        (("error_code",), ("status", "kawasaki", "error_code")),
        (("hold_reason",), ("hold", "text")),
        (("accepted", "turn"), ("accepted", "ownership")),
    ],
    "robot/command": [(("permission", "turn"), ("permission", "ownership"))],
    "arbiter/status": [(("turn",), ("ownership",))],
}
CHANGED = {"status", "accepted", "permission", "v"}


def at(fields: Any, path: tuple[str, ...]) -> Any:
    """Return the value at a path of plain data."""
    for name in path:
        fields = fields[name]
    return fields


@each_kept
def test_a_kept_message_of_an_older_version_is_read(version: int, key: str) -> None:
    """Field by field as it was written, under its own key and no other one."""
    data = KEPT[version, key]
    header, message = decode_recorded(data, BY_KEY[key].message, key)
    written = msgpack.unpackb(data, use_list=False)
    read = header.as_dict() | message.as_dict()
    for name in (written.keys() & read.keys()) - (CHANGED if key in MOVED else set()):
        assert as_written(read[name], written[name]) == written[name], name
    for old_path, new_path in MOVED.get(key, []):
        if key != "arbiter/status" or version == 2:  # version 1 had no owner there
            assert at(read, new_path) == at(written, old_path), old_path
    for other in BY_KEY:
        if other != key:
            with pytest.raises(MisroutedError):
                decode_recorded(data, BY_KEY[key].message, other)


def test_compliant_axes_had_other_names() -> None:
    """In a target of any version, and what is no list of axes is not touched."""
    fields: dict[str, Any] = {}
    axis = {"setpoint": 2.0, "exerted": 1.0, "deviation": 0.0, "at_limit": False}
    for version in READABLE_VERSIONS:
        for old, new in (("free", "compliant"), ("admittance", "compliant"), ("force", "force")):
            fields = unpack(KEPT[min(version, 2), "regulator/target"], READABLE_VERSIONS)
            fields |= {"v": version, "axes": [axis | {"control": old}]}
            _, message = decode_recorded(pack(fields), RegulatorTarget, "regulator/target")
            assert [(axis.control, axis.setpoint) for axis in message.axes] == [(new, 2.0)]
    fields |= {"axes": ["free"]}
    with pytest.raises(MessageError, match="axes"):
        decode_recorded(pack(fields), RegulatorTarget, "regulator/target")


@pytest.mark.parametrize(("key", "part"), [("robot/state", ()), ("robot/command", ("permission",))])
def test_a_recording_from_before_the_challenge_has_one(key: str, part: tuple[str, ...]) -> None:
    """The same in state and permission: a replayed arbiter arms. A recorded one is kept."""
    permission = Permission(host="pc", lease=1, deadline_s=0.1).as_dict()
    fields = unpack(KEPT[2, key], READABLE_VERSIONS) | {"permission": permission}
    for challenge in (None, 77):
        holder = fields["permission"] if part else fields
        holder.pop("challenge", None)
        if challenge is not None:
            holder["challenge"] = challenge
        data = readdressed(pack(fields), f"demo/{key}")
        _, message = decode_recorded(data, BY_KEY[key].message, key)
        assert at(message.as_dict(), (*part, "challenge")) == (challenge or 1)
        assert readdressed(data, f"demo/{key}") is data


@each_kept
def test_a_republished_message_has_version_and_address_of_today(version: int, key: str) -> None:
    """Readers of the cell take it, as from the recording itself."""
    data = KEPT[version, key]
    _, message = decode(readdressed(data, f"demo/{key}"), BY_KEY[key].message, f"demo/{key}")
    assert message == decode_recorded(data, BY_KEY[key].message, key)[1]


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x93\x01\x02\x03", pack({"v": 7}), b"\x80"])
def test_bytes_that_are_no_message_are_published_unchanged(data: bytes) -> None:
    """The recorder keeps undecodable bytes, and the replay does not repair them."""
    assert readdressed(data, "demo/wrench") == data


def test_an_old_recording_is_replayed_into_readers_of_today() -> None:
    """Every message, none refused for its version or address."""
    recorded = list(RecordedFile(OLD).raw_messages())
    assert len(recorded) > 1000
    world = VirtualCell(load_cell(DEMO))
    tap = world.transport.subscribe("demo/robot/state", 10**6)
    play(recorded, world.transport, "demo", clock=ManualClock())
    headers = [decode(data, RobotState, "demo/robot/state")[0] for data in iter(tap.take, None)]
    assert {header.v for header in headers} == {SCHEMA_VERSION}
    assert len(headers) == sum(each.topic == "robot/state" for each in recorded)


def test_the_verbs_open_an_old_recording(tmp_path: Path) -> None:
    """Export, report and a service that is fed with it: nothing is unreadable or left out."""
    count = sum(each.topic == "wrench" for each in RecordedFile(OLD).raw_messages())
    assert f"wrench.csv: {count} rows" in run("export", OLD, "-o", tmp_path / "tables").output
    page = tmp_path / "report.html"
    assert "1 stops" in run("report", OLD, "-o", page, "--no-3d").output
    assert "HOLDING · hold (501)" in page.read_text(encoding="utf-8")
    out = run("replay", OLD, "--to-service", "wrench").output
    # An older wrench service rounded its last digit otherwise.
    assert all(float(most) < 1e-12 for most in re.findall(r"differs by at most (\S+)", out))
    assert "differs in" not in out
    (now,) = re.findall(r"^  wrench: (\d+) recorded, (\d+) now: ", out, re.MULTILINE)
    assert now[0] == now[1] != "0"

"""Recordings of schema version 1, whose addresses lack the cell, open as those of today do.

tests/corpus/messages-version-1.json holds one message of each topic as the last program of version
1 encoded it.
"""

import base64
import json
from pathlib import Path
from typing import Any

import msgpack
import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.clock import ManualClock
from forcemesh.codec import SCHEMA_VERSION, decode, decode_recorded, pack, readdressed, unpack
from forcemesh.errors import MessageError, MisroutedError
from forcemesh.requests import ArmRequest, HoldRequest
from forcemesh.topics import TOPICS
from launch.virtual_cell import VirtualCell
from services.recorder.frames import Frame
from services.recorder.playback import play
from services.recorder.reading import RecordedFile
from services.recorder.recording import Recording
from services.recorder.wall_clock import Wall
from tests.fakes.recorder_bench import WALL_NS, cell_with, place

CORPUS = Path(__file__).resolve().parents[1] / "corpus" / "messages-version-1.json"
DEMO = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
KEPT = {key: base64.b64decode(data) for key, data in json.loads(CORPUS.read_text()).items()}
BY_KEY: dict[str, Any] = {topic.key: topic for topic in TOPICS}
each_kept = pytest.mark.parametrize("key", KEPT)


def aged(data: bytes) -> bytes:
    """Return a message of today as version 1 wrote it."""
    fields = unpack(data)
    return pack(fields | {"v": 1, "topic": fields["topic"].partition("/")[2]})


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of an arm that is armed and held, every message as version 1 wrote it."""
    folder = tmp_path_factory.mktemp("old")
    world = VirtualCell(load_cell(DEMO))
    listen = world.transport.subscribe
    taps = [(place(topic), listen(f"demo/{topic.key}", 10**6)) for topic in TOPICS]
    world.advance(1.5)
    assert world.client.ask(topics.ARM, ArmRequest()).accepted
    world.advance(0.2)
    assert world.client.ask(topics.HOLD, HoldRequest(reason="enough")).accepted
    world.advance(0.2)
    frames = []
    for number, tap in taps:
        while (data := tap.take()) is not None:
            frames.append(Frame(number, unpack(data)["stamp_ns"], aged(data)))
    frames.sort(key=lambda frame: frame.at_ns)
    recording = Recording(
        folder, "file", cell_with(folder), cause="asked",
        wall=Wall(world.clock.boot, WALL_NS), now_ns=frames[0].at_ns,
    )  # fmt: skip
    recording.write(frames, frames[-1].at_ns)
    recording.close()
    return recording.path


def run(*words: object) -> tuple[int, str]:
    """Run the command line; return exit code and standard output."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.stdout


def as_written(read: Any, said: Any) -> Any:
    """Return what was read without the fields that records got since: they have their defaults."""
    if isinstance(read, dict) and isinstance(said, dict) and said.keys() <= read.keys():
        return {name: as_written(read[name], said[name]) for name in said}
    return read


@each_kept
def test_a_kept_message_of_version_1_is_read(key: str) -> None:
    """Field by field what it says, under its own key and no other one."""
    header, message = decode_recorded(KEPT[key], BY_KEY[key].message, key)
    said = msgpack.unpackb(KEPT[key], use_list=False)
    read = header.model_dump() | message.model_dump()
    for name in said.keys() & read.keys():
        assert as_written(read[name], said[name]) == said[name], name
    for other in BY_KEY:
        if other != key:
            with pytest.raises(MisroutedError):
                decode_recorded(KEPT[key], BY_KEY[key].message, other)


@each_kept
def test_on_the_bus_version_1_is_refused(key: str) -> None:
    """A program that is older than the cell is told so; it is never half understood."""
    with pytest.raises(MessageError, match="schema version 1, this program uses 2"):
        decode(KEPT[key], BY_KEY[key].message, f"demo/{key}")


@each_kept
def test_what_is_published_again_has_version_and_address_of_today(key: str) -> None:
    """Readers of the cell take it; the body is as it was."""
    _, message = decode(readdressed(KEPT[key], f"demo/{key}"), BY_KEY[key].message, f"demo/{key}")
    assert message == decode_recorded(KEPT[key], BY_KEY[key].message, key)[1]


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x93\x01\x02\x03", pack({"v": 7, "topic": "x"})])
def test_what_is_no_message_is_published_as_it_is(data: bytes) -> None:
    """The recorder keeps strangers' bytes, and the replay does not repair them."""
    assert readdressed(data, "demo/wrench") == data


def test_an_old_recording_is_replayed_into_readers_of_today(old: Path) -> None:
    """Every message, none refused for its version or address."""
    heard = list(RecordedFile(old).heard())
    assert len(heard) > 1000
    assert {unpack(each.data)["v"] for each in heard} == {1}
    world = VirtualCell(load_cell(DEMO))
    tap = world.transport.subscribe("demo/robot/state", 10**6)
    play(heard, world.transport, "demo", clock=ManualClock())
    count = 0
    while (data := tap.take()) is not None:
        header, _ = decode(data, BY_KEY["robot/state"].message, "demo/robot/state")
        count += header.v == SCHEMA_VERSION
    assert count == sum(each.topic == "robot/state" for each in heard)


def test_the_verbs_open_an_old_recording(old: Path, tmp_path: Path) -> None:
    """Export, report and a service that is fed with it: nothing is unreadable or left out."""
    heard = list(RecordedFile(old).heard())
    code, out = run("export", old, "-o", tmp_path / "tables")
    assert code == 0
    assert f"wrench.csv: {sum(each.topic == 'wrench' for each in heard)} rows" in out
    code, out = run("report", old, "-o", tmp_path / "report.html", "--no-3d")
    assert code == 0
    assert "1 stops" in out
    assert "HOLDING · hold (501)" in (tmp_path / "report.html").read_text(encoding="utf-8")
    code, out = run("replay", old, "--to-service", "wrench")
    assert code == 0
    assert "all fields: equal" in out
    assert " 0 compared" not in out

"""Content of a recording: exact bytes, JSON by its schema, and access for other readers."""

import json
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap.records import Schema
from pydantic_core import from_json

from common.config.cell import CellConfig
from forcemesh.codec import Header, encode, pack
from forcemesh.errors import DataError
from forcemesh.topics import TOPICS, Topic
from services.recorder.frames import FRAMES_TOPIC, Frame, frames_of
from services.recorder.layout import layout_of, schema_of
from services.recorder.reading import RecordedFile
from services.recorder.recording import Recording
from services.recorder.stamps import WallClock
from tests.fakes.records import full, records
from tests.unit.services.recorder.conftest import WALL_NS, cell_with

CLOCK = "this clock"
SECOND = 10**9
each_topic = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)


def header(seq: int, topic: Topic[Any], stamp_ns: int, boot: str = CLOCK) -> Header:
    """Return the header of a message."""
    return Header(seq=seq, epoch=1, boot=boot, stamp_ns=stamp_ns, topic=f"demo/{topic.key}")


def opened(folder: Path, cell: CellConfig | None = None) -> Recording:
    """Return a recording without messages."""
    wall_clock = WallClock(CLOCK, WALL_NS)
    return Recording(cell or cell_with(folder), wall_clock, SECOND, cause="asked")


def recorded(folder: Path, frames: list[Frame], finish: bool = True) -> Path:
    """Return the file of frames that arrived in tenths of a second."""
    recording = opened(folder)
    for frame in frames:
        recording.write([frame], frame.at_ns)
    recording.write([], frames[-1].at_ns + SECOND)
    if finish:
        recording.close()
    else:
        recording.abandon()  # the state after a kill
    return recording.path


def of_every_topic(rounds: int = 3) -> list[Frame]:
    """Return full messages of every topic, one in each tenth of a second."""
    frames = []
    for number in range(rounds * len(TOPICS)):
        topic, at_ns = TOPICS[number % len(TOPICS)], SECOND + number * SECOND // 10
        message = topic.message.from_dict(full(topic.message))
        data = encode(header(1 + number // len(TOPICS), topic, at_ns), message)
        frames.append(Frame(TOPICS.index(topic), at_ns, data))
    return frames


@each_topic
@given(data=st.data())
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_json_of_a_message_keeps_its_schema_and_every_value(topic: Topic[Any], data: Any) -> None:
    """Random messages are valid by the schema, and each number and text is read back."""
    message_type: Any = topic.message
    message = data.draw(records(message_type))
    layout = layout_of(topic)
    read = from_json(layout.text(layout.read(encode(header(1, topic, 5), message))))
    Draft202012Validator(schema_of(topic)).validate(read)
    values = {k: v for k, v in flat(message.as_dict()).items() if v is not None}
    assert values.items() <= flat(read).items()


def flat(value: Any, path: str = "") -> dict[str, Any]:
    """Return every scalar value by its path; vectors have letters."""
    items: Any
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list | tuple):
        is_vector = len(value) in (3, 4) and all(type(part) is float for part in value)
        items = zip("xyzw", value) if is_vector else enumerate(value)  # noqa: B905
    else:
        return {path: value}
    return {k: v for name, inner in items for k, v in flat(inner, f"{path}/{name}").items()}


UNDECODABLE = {
    "nothing": b"",
    "no map": pack({}) + b"\x00",
    "an array that claims to be endless": b"\xdd\xff\xff\xff\xff",
    "a map that claims to be endless": b"\xdf\xff\xff\xff\xff",
    "nested beyond reason": b"\x81\xa4more" + b"\x91" * 3000,
    "text that is none": b"\x81\xa4boot\xa2\xff\xfe",
    "no head": pack({"valid": True}),
    "a stamp that is none": pack({"seq": 2, "epoch": 1, "boot": CLOCK, "stamp_ns": "now"}),
}


def test_undecodable_bytes_are_kept_exactly(tmp_path: Path) -> None:
    """They have their time of arrival, are counted, and do not affect other messages."""
    frames: list[Frame] = []
    for topic in TOPICS:
        good = encode(header(1, topic, SECOND + len(frames)), topic.message())
        frames += [
            Frame(TOPICS.index(topic), SECOND + len(frames) + number, data)
            for number, data in enumerate((good, *UNDECODABLE.values()))
        ]
    recording = opened(tmp_path)
    recording.write(frames, SECOND)
    recording.close()
    read = RecordedFile(recording.path)
    bad = [frame for frame in frames if frame.data in UNDECODABLE.values()]
    assert [h.data for h in read.raw_messages()] == [frame.data for frame in frames]
    arrived = {h.at_ns - WALL_NS for h in read.raw_messages()}
    assert {frame.at_ns for frame in bad} <= arrived
    assert len(list(read.messages())) == len(TOPICS)
    counts = (recording.messages, recording.unshaped, recording.gaps.lost)
    assert counts == (len(frames), len(bad), 0)


def test_the_mcap_package_reads_it_with_every_check(tmp_path: Path) -> None:
    """Checksums, statistics, metadata and attachment; our reader has every byte, time and topic."""
    sent = of_every_topic()
    path = recorded(tmp_path, sent)
    keys = [TOPICS[frame.topic].key for frame in sent]
    times = [WALL_NS + frame.at_ns for frame in sent]
    raw = list(zip(keys, times, (frame.data for frame in sent), strict=True))
    assert list(RecordedFile(path).raw_messages()) == raw
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        messages = list(reader.iter_messages(topics=keys))
        packed = list(reader.iter_messages(topics=[FRAMES_TOPIC]))
        (about,) = list(reader.iter_metadata())
        (cell,) = list(reader.iter_attachments())
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(messages) + len(packed)
    assert [channel.topic for _, channel, _ in messages] == keys
    assert [message.log_time for *_, message in messages] == times
    assert all(schema.encoding == "jsonschema" for schema, *_ in messages if schema)
    assert all(json.loads(message.data)["topic"] == f"demo/{c.topic}" for _, c, message in messages)
    assert about.metadata["wall_minus_monotonic_ns"] == str(WALL_NS)
    assert cell.name == "cell.yaml"
    assert summary.channels[packed[0][1].id].message_encoding == "protobuf"
    parts = [by_its_schema(schema, message.data) for schema, _, message in packed]
    assert [frame.data for part in parts for frame in frames_of(part)] == [f.data for f in sent]


def by_its_schema(schema: Schema | None, message: bytes) -> Any:
    """Return the packed frames of a message as Google's package reads it by the file's schema."""
    assert schema is not None
    assert schema.encoding == "protobuf"
    described = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
    assert described.SerializeToString(deterministic=True) == schema.data
    pool = descriptor_pool.DescriptorPool()
    pool.Add(described.file[0])
    kind: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return kind.FromString(message).packed


@given(finish=st.booleans(), cut=st.integers(0, 40_000), tail=st.binary(max_size=12))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_beginning_of_a_file_is_read_or_refused(
    tmp_path: Path, finish: bool, cut: int, tail: bytes
) -> None:
    """Also after a kill and with half a record at its end: its first messages, or none."""
    frames = of_every_topic()
    folder = tmp_path / f"finished {finish}"
    if not folder.exists():
        recorded(folder, frames, finish)
    data = next(folder.glob("*.mcap")).read_bytes()
    path = tmp_path / "part.mcap"
    path.write_bytes(data[:cut] + tail)
    try:
        read = RecordedFile(path)
        messages = [h.data for h in read.raw_messages()]
    except DataError as error:
        is_whole, messages, refused = False, [], str(error)
    else:
        is_whole, refused = read.is_whole, ""
    assert not refused or "part.mcap: not a" in refused
    assert messages == [frame.data for frame in frames[: len(messages)]]
    if cut >= len(data):
        assert (len(messages), is_whole) == (len(frames), finish)


def test_a_recording_does_not_contain_the_panels_token(tmp_path: Path) -> None:
    """The attached cell file lacks the section with the access tokens."""
    tree = cell_with(tmp_path).model_copy(deep=True)
    secret = tree.panel.model_copy(update={"token": "a-secret-of-this-lab"})
    cell = tree.model_copy(update={"panel": secret})
    recording = opened(tmp_path, cell)
    recording.close()
    assert b"a-secret-of-this-lab" not in recording.path.read_bytes()
    assert RecordedFile(recording.path).cell is not None


@given(st.integers(0, 2**62), st.integers(0, 500 * SECOND))
def test_each_machines_clock_has_one_offset(first_ns: int, later_ns: int) -> None:
    """Intervals between stamps of one machine stay; the first of another one counts as now."""
    wall = WallClock(CLOCK, WALL_NS)
    first = wall.written_ns("other", first_ns, 1000)
    later = wall.written_ns("other", first_ns + later_ns, 1000)
    assert first == WALL_NS + 1000
    assert later - first == later_ns
    assert wall.written_ns(CLOCK, 700, 1000) == WALL_NS + 700


@given(st.integers(-(2**63), -(2**50)) | st.integers(2**50, 2**64 - 1))
def test_an_absurd_stamp_is_replaced_by_the_time_of_arrival(stamp_ns: int) -> None:
    """A stamp far from the present changes no other time in the file."""
    wall = WallClock(CLOCK, WALL_NS)
    assert wall.written_ns(CLOCK, stamp_ns, 1000) == WALL_NS + 1000

"""Content of a recording: exact bytes, JSON by its schema, and access for other readers."""

import json
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from pydantic_core import from_json

from forcemesh.codec import Header, encode, pack
from forcemesh.errors import DataError
from forcemesh.topics import TOPICS, Topic
from services.recorder.frames import Frame, frames_of, pack_frames
from services.recorder.layout import layout_of, schema_of
from services.recorder.reading import RecordedFile
from services.recorder.recording import Recording
from services.recorder.stamps import WallClock
from tests.fakes.recorder_bench import WALL_NS, cell_with, place
from tests.fakes.records import full, records

CLOCK = "this clock"
SECOND = 10**9
each_topic = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)


def header(seq: int, topic: Topic[Any], stamp_ns: int, boot: str = CLOCK) -> Header:
    """Return the header of a message."""
    return Header(seq=seq, epoch=1, boot=boot, stamp_ns=stamp_ns, topic=f"demo/{topic.key}")


def recorded(folder: Path, frames: list[Frame], finish: bool = True) -> Path:
    """Return the file of frames that arrived in tenths of a second."""
    wall = WallClock(CLOCK, WALL_NS)
    recording = Recording(
        folder, "file", cell_with(folder), cause="asked", wall_clock=wall, now_ns=frames[0].at_ns
    )
    for frame in frames:
        recording.write([frame], frame.at_ns)
    recording._flush()
    if finish:
        recording.close()
    else:
        recording._stream.close()  # the state after a kill, without the unflushed part
    return recording.path


def of_every_topic(rounds: int = 3) -> list[Frame]:
    """Return full messages of every topic, one in each tenth of a second."""
    frames = []
    for number in range(rounds * len(TOPICS)):
        topic, at_ns = TOPICS[number % len(TOPICS)], SECOND + number * SECOND // 10
        message = topic.message.from_dict(full(topic.message))
        data = encode(header(1 + number // len(TOPICS), topic, at_ns), message)
        frames.append(Frame(place(topic), at_ns, data))
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


@pytest.mark.parametrize("data", UNDECODABLE.values(), ids=UNDECODABLE.keys())
@each_topic
def test_undecodable_bytes_are_kept_exactly(topic: Topic[Any], data: bytes, tmp_path: Path) -> None:
    """They have their time of arrival, are counted, and do not affect other messages."""
    good = encode(header(1, topic, SECOND), topic.message())
    frames = [
        Frame(place(topic), SECOND + number, each) for number, each in enumerate((good, data))
    ]
    recording = Recording(
        tmp_path,
        "file",
        cell_with(tmp_path),
        cause="",
        wall_clock=WallClock(CLOCK, WALL_NS),
        now_ns=SECOND,
    )
    recording.write(frames, SECOND)
    recording.close()
    read = RecordedFile(recording.path)
    assert [h.data for h in read.raw_messages()] == [good, data]
    assert [h.at_ns - WALL_NS for h in read.raw_messages()] == [SECOND, SECOND + 1]
    assert len(list(read.messages())) == 1
    assert (recording.messages, recording.unshaped, recording.numbering.lost) == (2, 1, 0)


@each_topic
def test_an_undecodable_body_still_has_its_number_and_time(
    topic: Topic[Any], tmp_path: Path
) -> None:
    """Only the header can be decoded: nothing counts as lost, and its stamp is used."""
    heads = [header(number, topic, SECOND // number) for number in (1, 2, 3)]
    bodies: list[dict[str, Any]] = [topic.message().as_dict()] * 3
    bodies[1] = {"valid": "perhaps"}
    frames = [
        Frame(place(topic), SECOND, pack(head.as_dict() | body))
        for head, body in zip(heads, bodies, strict=True)
    ]
    path = recorded(tmp_path, frames)
    times = {h.data: h.at_ns - WALL_NS for h in RecordedFile(path).raw_messages()}
    assert [times[frame.data] for frame in frames] == [head.stamp_ns for head in heads]
    assert [message.fields["seq"] for message in RecordedFile(path).messages()] == [1, 3]


@each_topic
def test_the_schema_is_readable_by_simple_viewers(topic: Topic[Any]) -> None:
    """There is one type for each field: no references, alternatives or null."""

    def check(schema: dict[str, Any]) -> None:
        assert not set(schema) & {"$ref", "$defs", "anyOf", "oneOf", "allOf", "prefixItems"}
        assert schema["type"] in {"object", "array", "string", "number", "integer", "boolean"}
        if schema["type"] == "object":
            for inner in schema["properties"].values():
                check(inner)
        if schema["type"] == "array":
            check(schema["items"])

    check(schema_of(topic))
    assert schema_of(topic)["type"] == "object"
    Draft202012Validator.check_schema(schema_of(topic))


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 2**64 - 1), st.binary())))
def test_frames_are_read_back_exactly(parts: list[tuple[int, int, bytes]]) -> None:
    """All received frames are read back in their order."""
    frames = [Frame(*part) for part in parts]
    assert list(frames_of(pack_frames(frames))) == frames


@given(st.binary(min_size=1), st.integers(1, 12))
def test_truncated_frames_are_an_error(data: bytes, cut: int) -> None:
    """An end within a header or a message is an error and not a shorter message."""
    with pytest.raises(ValueError, match="frames end"):
        list(frames_of(pack_frames([Frame(0, 1, data)])[: -min(cut, len(data))]))


def test_a_recording_has_every_message_in_order_of_time(tmp_path: Path) -> None:
    """The bytes are equal, and the time is the wall clock at arrival."""
    frames = of_every_topic()
    messages = list(RecordedFile(recorded(tmp_path, frames)).raw_messages())
    assert [h.data for h in messages] == [frame.data for frame in frames]
    assert [h.at_ns for h in messages] == [WALL_NS + frame.at_ns for frame in frames]
    assert [h.topic for h in messages] == [TOPICS[frame.topic].key for frame in frames]


def test_the_mcap_package_reads_it_with_every_check(tmp_path: Path) -> None:
    """Summary, statistics, checksums, indexes, metadata and attachment conform to the format."""
    frames = of_every_topic()
    with recorded(tmp_path, frames).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        values = {channel.topic: counts[channel.id] for channel in summary.channels.values()}
        messages = list(reader.iter_messages(topics=[topic.key for topic in TOPICS]))
        (about,) = list(reader.iter_metadata())
        (cell,) = list(reader.iter_attachments())
    assert all(values[topic.key] == 3 for topic in TOPICS)
    assert [m.log_time for *_, m in messages] == [WALL_NS + frame.at_ns for frame in frames]
    assert all(schema.encoding == "jsonschema" for schema, *_ in messages if schema)
    assert all(json.loads(message.data)["topic"] == f"demo/{c.topic}" for _, c, message in messages)
    assert about.metadata["wall_minus_monotonic_ns"] == str(WALL_NS)
    assert cell.name == "cell.yaml"


def test_written_memory_is_split_into_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A large amount at one time makes no oversized chunk; nothing is missing."""
    monkeypatch.setattr("services.recorder.recording.CHUNK_B", 5_000)
    frames = [frame._replace(at_ns=SECOND) for frame in of_every_topic(rounds=9)]
    path = recorded(tmp_path, frames)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 5
    assert max(chunk.uncompressed_size for chunk in summary.chunk_indexes) < 20_000
    assert len(list(RecordedFile(path).raw_messages())) == len(frames)


def test_the_mcap_package_jumps_to_a_time_in_it(tmp_path: Path) -> None:
    """The chunk and message indexes select the messages of an interval."""
    frames = of_every_topic()
    begin, end = frames[10].at_ns + WALL_NS, frames[20].at_ns + WALL_NS
    with recorded(tmp_path, frames).open("rb") as stream:
        keys = [topic.key for topic in TOPICS]
        found = make_reader(stream).iter_messages(keys, starting_at=begin, ending_before=end)
        times = [message.log_time for *_, message in found]
    assert times == [WALL_NS + frame.at_ns for frame in frames[10:20]]


@pytest.mark.parametrize("tail", [b"", b"\x06", b"\x06\xff\xff\x00\x00\x00\x00\x00\x00abc"])
def test_a_truncated_file_is_read_up_to_its_end(tmp_path: Path, tail: bytes) -> None:
    """After a kill, also with half a record at the end, both readers read it."""
    frames = of_every_topic()
    path = recorded(tmp_path, frames, finish=False)
    path.write_bytes(path.read_bytes() + tail)
    read = RecordedFile(path)
    assert [h.data for h in read.raw_messages()] == [frame.data for frame in frames]
    assert not read.is_whole
    read_messages: list[object] = []
    with path.open("rb") as stream, suppress(McapError, struct.error):
        read_messages.extend(NonSeekingReader(stream).iter_messages(log_time_order=False))
    assert len(read_messages) > len(frames)


@given(cut=st.integers(0, 40_000))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_beginning_of_a_file_is_read_or_refused(tmp_path: Path, cut: int) -> None:
    """A file cut at any place gives its first messages or is rejected."""
    frames = of_every_topic()
    whole = tmp_path / "file-01.mcap"
    if not whole.exists():
        recorded(tmp_path, frames)
    part = tmp_path / "part.mcap"
    part.write_bytes(whole.read_bytes()[:cut])
    try:
        messages = list(RecordedFile(part).raw_messages())
    except DataError:
        return
    assert [h.data for h in messages] == [frame.data for frame in frames[: len(messages)]]


@pytest.mark.parametrize("content", [b"", b"nothing of that kind", b"\x89MCAP0\r\n"])
def test_a_file_that_is_no_recording_is_rejected(tmp_path: Path, content: bytes) -> None:
    """The error is a sentence with the file's name."""
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"other\.mcap: not a recording"):
        RecordedFile(path)


def test_a_recording_does_not_contain_the_panels_token(tmp_path: Path) -> None:
    """The attached cell file lacks the section with the access tokens."""
    tree = cell_with(tmp_path).model_copy(deep=True)
    secret = tree.panel.model_copy(update={"token": "a-secret-of-this-lab"})
    cell = tree.model_copy(update={"panel": secret})
    wall = WallClock(CLOCK, WALL_NS)
    recording = Recording(tmp_path, "file", cell, cause="asked", wall_clock=wall, now_ns=1)
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

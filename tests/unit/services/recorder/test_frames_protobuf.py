"""Frames of a recording in protobuf, compared with Google's package."""

from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from services.recorder import frames
from services.recorder.frames import frames_of
from services.recorder.recording import FRAMES_TOPIC
from tests.unit.services.recorder.test_recording import of_every_topic, recorded


def message_type(schema: bytes) -> Any:
    """Return the type that a file's schema describes."""
    described = descriptor_pb2.FileDescriptorSet.FromString(schema)
    assert described.SerializeToString(deterministic=True) == schema
    pool = descriptor_pool.DescriptorPool()
    pool.Add(described.file[0])
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(frames.NAME))


def test_a_file_can_be_read_by_its_own_schema(tmp_path: Path) -> None:
    """A reader without forcemesh finds every message in the channel `frames`."""
    sent = of_every_topic()
    found: list[bytes] = []
    with recorded(tmp_path, sent).open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages([FRAMES_TOPIC]):
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            packed = message_type(schema.data).FromString(message.data).packed
            found += [frame.data for frame in frames_of(packed)]
    assert found == [frame.data for frame in sent]

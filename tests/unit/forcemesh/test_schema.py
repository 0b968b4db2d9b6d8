"""JSON Schema of the messages on the bus: it holds for every message, and the hub publishes it."""

import json
from typing import Any

import msgpack
import pytest
from jsonschema import Draft202012Validator
from msgspec.structs import fields

from common.bus.configured_cell import ConfiguredCell
from forcemesh.codec import Envelope, Header, encode, encode_record
from forcemesh.requests import Reply
from forcemesh.schema import describe, topic_schema
from forcemesh.topics import REQUESTS, TOPICS, Request, Topic
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import CELL
from tests.fakes.records import full

HEADER = Header(seq=1, epoch=2, boot="b", stamp_ns=3, topic="t")
each_topic = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
each_request = pytest.mark.parametrize("request_row", REQUESTS, ids=lambda row: row.key)


def mistakes(schema: dict[str, Any], data: bytes) -> list[str]:
    """Return the mistakes that an independent validator finds in bytes from the bus."""
    Draft202012Validator.check_schema(schema)
    fields = json.loads(json.dumps(msgpack.unpackb(data)))
    return [error.message for error in Draft202012Validator(schema).iter_errors(fields)]


@each_topic
def test_every_message_fits_its_schema(topic: Topic[Any]) -> None:
    """With nothing but defaults and with every field filled; every field is there."""
    schema = topic_schema(topic)
    for message in (topic.message(), topic.message.from_dict(full(topic.message))):
        data = encode(HEADER, message)
        assert mistakes(schema, data) == []
        assert set(msgpack.unpackb(data)) == set(schema["required"]) == set(schema["properties"])


@each_topic
def test_a_schema_finds_wrong_fields(topic: Topic[Any]) -> None:
    """A field of another type, and one that is missing."""
    schema, fields = topic_schema(topic), msgpack.unpackb(encode(HEADER, topic.message()))
    assert mistakes(schema, msgpack.packb({**fields, "valid": "yes"}))
    assert mistakes(schema, msgpack.packb({k: v for k, v in fields.items() if k != "seq"}))


@each_request
def test_every_request_fits_its_schema(request_row: Request[Any]) -> None:
    """As our own clients send it; fields with a default may be left out."""
    schema = describe()["requests"][request_row.key]["schema"]
    asked = request_row.message.from_dict(full(request_row.message))
    assert mistakes(schema, encode_record(asked, Envelope(topic=request_row.key))) == []
    needed = {field.name for field in fields(request_row.message) if field.required}
    assert set(schema["required"]) == needed


def test_every_reply_fits_its_schema() -> None:
    """Accepted, and refused with numbers."""
    for reply in (Reply(accepted=True), Reply(accepted=False, code="x", value=1.0, limit=2.0)):
        assert mistakes(describe()["reply"], encode_record(reply)) == []


def test_a_client_gets_the_schema_from_the_hub() -> None:
    """The whole table, from the running cell."""
    cell = VirtualCell(CELL)
    assert ConfiguredCell(CELL, bus=cell.client).describe() == describe()

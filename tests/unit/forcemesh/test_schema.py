"""JSON Schema of the messages on the bus: it holds for every message, and the hub publishes it."""

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh
from jsonschema import Draft202012Validator
from msgspec.structs import fields

from common.bus.cell_bus import open_hub
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.codec import Envelope, Header, encode, encode_record
from forcemesh.requests import Reply
from forcemesh.schema import describe, describer, topic_schema
from forcemesh.topics import REQUESTS, TOPICS, Request, Topic
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import CELL
from tests.fakes.records import full

ROOT = Path(__file__).resolve().parents[3]
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


@pytest.fixture
def endpoint() -> Iterator[str]:
    """A hub that answers, and where it is."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        where = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    cell = load_cell(ROOT / "cells" / "demo.yaml", {"bus.endpoint": where})
    stop, ready = threading.Event(), threading.Event()

    def serve() -> None:
        with open_hub(cell) as bus:
            server = describer(bus)
            ready.set()
            while not stop.wait(0.01):
                server.step()

    thread = threading.Thread(target=serve)
    thread.start()
    assert ready.wait(20.0)
    yield where
    stop.set()
    thread.join()


@pytest.mark.realtime
def test_a_program_without_forcemesh_gets_the_schema_from_the_hub(endpoint: str) -> None:
    """With Zenoh's own client and nothing of ours: plain JSON under one key."""
    text = json.dumps({"mode": "client", "connect": {"endpoints": [endpoint], "timeout_ms": 10000}})
    with zenoh.open(zenoh.Config.from_json5(text)) as session:
        answers = [reply.ok for reply in session.get("demo/describe", timeout=10.0)]
        assert [json.loads(each.payload.to_bytes()) for each in answers if each] == [describe()]

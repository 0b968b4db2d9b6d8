"""The rules of the bus table: writer, readers, rate and deadline of each topic."""

import json
from typing import Any

import msgpack
import pytest
import zenoh
from jsonschema import Draft202012Validator
from msgspec.structs import fields

from common.config.cell import Deadlines, Rates
from common.config.load import load_cell
from forcemesh import messages as m
from forcemesh import topics
from forcemesh.codec import Envelope, Header, encode, encode_record
from forcemesh.records import Record
from forcemesh.schema import describe, topic_schema
from forcemesh.topics import (
    CLIENT,
    HEALTH,
    HELPERS,
    REQUESTS,
    ROLES,
    SERVED,
    TOPICS,
    Request,
    Topic,
)
from tests.fakes.bench import DEMO
from tests.fakes.records import full

ROWS: tuple[Topic[Any] | Request[Any], ...] = (*TOPICS, *REQUESTS)
MOST_BYTES = 1400  # of 1500, with address and headers
HEADER = Header(seq=10**9, epoch=2**62, boot="b" * 50, stamp_ns=10**15, sensor_stamp_ns=10**15)

each_topic = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
each_request = pytest.mark.parametrize("request_row", REQUESTS, ids=lambda row: row.key)
each_row = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.key)

TEXT = "robot/state stale: 123 ms old, limit 100 ms"
TRIP = m.Trip(code="workspace", rule=401, text=TEXT, value=0.1234, limit=0.12)
# What a full message does not show: several of a kind, and long texts.
SEVERAL: dict[str, dict[str, Any]] = {
    "arbiter/status": {"trips": (TRIP,) * 2, "not_ready": (TEXT,) * 5, "clears": TEXT},
    **{
        topic.key: {"counters": {f"counter_{i}": 10**6 for i in range(10)}, "fault": TEXT}
        for topic in HEALTH.values()
    },
}


def test_every_row_of_the_module_is_in_the_tables_once() -> None:
    """A row that a service could import but that no test has would escape every rule below."""
    rows = [value for value in vars(topics).values() if isinstance(value, Topic | Request)]
    rows += [*HEALTH.values(), *SERVED.values()]
    assert {id(row) for row in rows} == {id(row) for row in ROWS}
    assert len({row.key for row in ROWS}) == len(ROWS)


@each_row
def test_a_key_is_canonical_and_has_its_purpose(row: Topic[Any] | Request[Any]) -> None:
    """Zenoh takes the key as it stands, alone and below a cell's name; no wildcard, no verbatim."""
    assert len(row.summary) > 10
    assert not row.summary.endswith(".")
    for key in (row.key, f"demo/{row.key}"):
        assert str(zenoh.KeyExpr(key)) == key
        assert str(zenoh.KeyExpr.autocanonize(key)) == key
    assert not set(row.key) & set("*$?#@ ")
    assert row.key == row.key.lower()


@each_topic
def test_exactly_one_role_writes_and_never_reads_its_own_words(topic: Topic[Any]) -> None:
    """One writer, a role of the cell; readers are clients and other roles, each named once."""
    assert CLIENT in topic.readers
    assert topic.writer in (*ROLES, *HELPERS)
    assert topic.writer not in topic.readers
    assert set(topic.readers) <= {*ROLES, CLIENT}
    assert len(topic.readers) == len(set(topic.readers))


@each_request
def test_a_role_serves_each_request(request_row: Request[Any]) -> None:
    """A client asks, a role answers; the message is a record that has no header."""
    assert request_row.server in (*ROLES, *HELPERS)
    assert issubclass(request_row.message, Record)
    assert not issubclass(request_row.message, m.Message)


@pytest.mark.parametrize("role", [*ROLES, *HELPERS])
def test_every_role_reports_its_health(role: str) -> None:
    """The arbiter watches that of the other roles; no role waits for a helper."""
    row = HEALTH[role]
    assert (row.key, row.writer, row.message) == (f"{role}/health", role, m.Health)
    assert ("arbiter" in row.readers) == (role in ROLES and role != "arbiter")
    if role in HELPERS:
        assert role not in ROLES
        assert all(topic.readers == (CLIENT,) for topic in TOPICS if topic.writer == role)


def test_exactly_the_roles_with_requests_publish_what_they_serve() -> None:
    """Without a row of its own a request would be in no recording; only clients read it."""
    assert set(SERVED) == {row.server for row in REQUESTS}
    for role, row in SERVED.items():
        assert (row.key, row.writer, row.readers) == (f"{role}/requests", role, (CLIENT,))
    occasional = {topic.key for topic in TOPICS if topic.occasional}
    assert occasional - {r.key for r in SERVED.values()} == {topics.ROBOT_SIGNALS.key}


def test_rates_and_deadlines_are_those_of_the_cell_file() -> None:
    """Each is a number in every cell file; one without effect would mislead who sets it."""
    assert {f"{topic.rate}_hz" for topic in TOPICS} == set(Rates.model_fields)
    assert {f"{topic.deadline}_s" for topic in TOPICS} == set(Deadlines.model_fields)


@pytest.mark.parametrize("control_hz", [5.0, 20.0, 75.0, 76.0, 250.0, 1000.0])
def test_a_slow_cell_is_not_stale_too_soon(control_hz: float) -> None:
    """At 15 Hz a message of 60 ms is fresh: three periods win where they are longer."""
    cell = load_cell(DEMO, {"rates.control_hz": control_hz, "deadlines.command_s": 0.04})

    assert cell.stale_after_s(topics.REGULATOR_TARGET) == max(3.0 / control_hz, 0.04)


@each_topic
def test_a_message_fits_in_a_packet_of_the_network(topic: Topic[Any]) -> None:
    """On a bad day too, with every field set: one Ethernet frame, no fragments."""
    message = topic.message.from_dict(full(topic.message))
    message = message.replaced(reason=TEXT, **SEVERAL.get(topic.key, {}))
    assert len(encode(HEADER, message)) < MOST_BYTES


# --- JSON Schema, which the hub publishes ---------------------------------------------------------


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

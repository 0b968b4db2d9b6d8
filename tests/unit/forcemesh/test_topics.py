"""The rules of the bus table: writer, readers, rate and deadline of each topic."""

from pathlib import Path
from typing import Any

import pytest
import zenoh

from common.config.cell import CellConfig, Deadlines, Rates
from common.config.load import load_cell
from forcemesh import messages as m
from forcemesh import requests as q
from forcemesh import topics
from forcemesh.codec import Header, encode
from forcemesh.records import Record
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
from tests.fakes.records import full

ROOT = Path(__file__).resolve().parents[3]
CELLS = sorted((ROOT / "cells").glob("*.yaml"))
ROWS: tuple[Topic[Any] | Request[Any], ...] = (*TOPICS, *REQUESTS)
MOST_BYTES = 1000
HEADER = Header(seq=10**9, epoch=2**62, boot="b" * 50, stamp_ns=10**15, sensor_stamp_ns=10**15)

each_topic = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
each_request = pytest.mark.parametrize("request_row", REQUESTS, ids=lambda row: row.key)
each_row = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.key)
each_cell = pytest.mark.parametrize("path", CELLS, ids=lambda path: path.stem)

TEXT = "robot/state stale: 123 ms old, limit 100 ms"
POSE = m.PoseRecord.from_dict(full(m.PoseRecord))
FEEDBACK = m.Feedback.from_dict(full(m.Feedback))
TRIP = m.Trip(code="workspace", rule=401, text=TEXT, value=0.1234, limit=0.12)
# Messages with a fault that a full one does not show; two kinds of command exclude each other.
# Of every other row: one with every field set.
REALISTIC: dict[str, m.Message] = {
    "robot/state": m.RobotState(
        accepted=m.Accepted.from_dict(full(m.Accepted)),
        goal=m.GoalReport(id=12345, state="refused", reason=TEXT),
        hold=TRIP,
        joint_rad=(0.1,) * 7,
        status=m.RobotStatus(faults=(TRIP,), kawasaki=m.KawasakiStatus()),
        link=m.LinkHealth(connected=True, round_trip_s=0.0123, reconnects=12, errors=3),
    ),
    "regulator/target": m.RegulatorTarget(
        valid=False, reason=TEXT, mode="orientation", pose=POSE, feedback=FEEDBACK
    ),
    "robot/command": m.RobotCommand(
        reason=TEXT,
        permission=m.Permission(host="controller", lease=12345, deadline_s=0.1),
        goal=m.Goal(id=12345, kind="pose", pose=POSE, joint_rad=(0.1,) * 7),
        pose=POSE,
    ),
    "arbiter/status": m.ArbiterStatus(
        state="HOLDING", lease=12345, trips=(TRIP,) * 2, not_ready=(TEXT,) * 5, clears=TEXT
    ),
    "recorder/status": m.RecorderStatus(
        valid=False, reason=TEXT, file="/a/folder/" * 20, messages=10**9, memory_bytes=10**9
    ),
} | {
    topic.key: m.Health(
        counters={f"counter_{i}": 10**6 for i in range(10)},
        version="0.1.0",
        config_hash="0123456789ab",
        fault=TEXT,
    )
    for topic in HEALTH.values()
}


def test_every_row_of_the_module_is_in_the_tables_once() -> None:
    """A row that a service could import but that no test has would escape every rule below."""
    rows = [value for value in vars(topics).values() if isinstance(value, Topic | Request)]
    rows += [*HEALTH.values(), *SERVED.values()]

    assert {id(row) for row in rows} == {id(row) for row in ROWS}
    assert len(ROWS) == len({id(row) for row in ROWS})


def test_keys_are_unique() -> None:
    """Two rows never share a key, be they topics or requests."""
    keys = [row.key for row in ROWS]

    assert sorted(keys) == sorted(set(keys))


@each_row
def test_a_key_is_canonical_and_names_one_thing(row: Topic[Any] | Request[Any]) -> None:
    """Zenoh takes the key as it stands, alone and below a cell's name; no wildcard, no verbatim."""
    for key in (row.key, f"demo/{row.key}"):
        assert str(zenoh.KeyExpr(key)) == key
        assert str(zenoh.KeyExpr.autocanonize(key)) == key
    assert not set(row.key) & set("*$?#@ ")
    assert row.key == row.key.lower()


@each_row
def test_a_row_has_its_purpose(row: Topic[Any] | Request[Any]) -> None:
    """The summary is the user's only documentation of a key."""
    assert len(row.summary) > 10
    assert not row.summary.endswith(".")


@each_topic
def test_exactly_one_role_writes_and_never_reads_its_own_words(topic: Topic[Any]) -> None:
    """One writer, a role of the cell; readers are other roles or clients, each named once."""
    assert topic.writer in (*ROLES, *HELPERS)
    assert topic.writer not in topic.readers
    assert set(topic.readers) <= {*ROLES, CLIENT}
    assert len(topic.readers) == len(set(topic.readers))


@each_topic
def test_a_client_may_watch_everything(topic: Topic[Any]) -> None:
    """No topic of the bus is hidden from a client that watches."""
    assert CLIENT in topic.readers


@each_request
def test_a_role_serves_each_request(request_row: Request[Any]) -> None:
    """A client asks, a role answers; the message is a record that has no header."""
    assert request_row.server in (*ROLES, *HELPERS)
    assert issubclass(request_row.message, Record)
    assert not issubclass(request_row.message, m.Message)


def test_hold_and_clear_need_no_words() -> None:
    """The request that stops the arm can be sent as an empty map."""
    assert topics.HOLD.message() == q.HoldRequest()
    assert topics.CLEAR.message() == q.Empty()


@pytest.mark.parametrize("role", ROLES)
def test_every_role_reports_its_health(role: str) -> None:
    """A health row per role, written by that role, watched by the arbiter (except its own)."""
    row = HEALTH[role]

    assert (row.key, row.writer, row.message) == (f"{role}/health", role, m.Health)
    assert ("arbiter" in row.readers) == (role != "arbiter")


def test_exactly_the_roles_with_requests_publish_what_they_serve() -> None:
    """Without a row of its own a request would be in no recording; only clients read it."""
    assert set(SERVED) == {row.server for row in REQUESTS}
    for role, row in SERVED.items():
        assert (row.key, row.writer, row.readers) == (f"{role}/requests", role, (CLIENT,))
    occasional = {topic.key for topic in TOPICS if topic.occasional}
    assert occasional - {r.key for r in SERVED.values()} == {topics.ROBOT_SIGNALS.key}


@pytest.mark.parametrize("helper", HELPERS)
def test_nothing_that_moves_the_arm_waits_for_a_helper(helper: str) -> None:
    """It reports its health to the clients that watch, and no role reads it."""
    row = HEALTH[helper]

    assert (row.key, row.writer, row.message) == (f"{helper}/health", helper, m.Health)
    assert all(topic.readers == (CLIENT,) for topic in TOPICS if topic.writer == helper)
    assert helper not in ROLES


@each_topic
def test_rate_and_deadline_are_names_of_the_cell_file(topic: Topic[Any]) -> None:
    """Each rate and deadline of the table is a number in every cell file."""
    assert f"{topic.rate}_hz" in Rates.model_fields
    assert f"{topic.deadline}_s" in Deadlines.model_fields


def test_no_rate_or_deadline_is_without_a_topic() -> None:
    """A number without effect would mislead the user who sets it."""
    rates = {f"{topic.rate}_hz" for topic in TOPICS}
    deadlines = {f"{topic.deadline}_s" for topic in TOPICS}

    assert rates == set(Rates.model_fields)
    assert deadlines == set(Deadlines.model_fields)


@each_cell
@each_topic
def test_stale_is_three_periods_and_never_sooner_than_the_deadline(
    path: Path, topic: Topic[Any]
) -> None:
    """In every cell file that ships, for every topic."""
    cell = load_cell(path)
    stale_s = cell.stale_after_s(topic)

    assert stale_s >= 3.0 / cell.rate_hz(topic)
    assert stale_s >= getattr(cell.deadlines, f"{topic.deadline}_s")


@pytest.mark.parametrize("control_hz", [5.0, 20.0, 75.0, 76.0, 250.0, 1000.0])
def test_a_slow_cell_is_not_stale_too_soon(control_hz: float) -> None:
    """At 15 Hz a message of 60 ms is fresh: three periods win where they are longer."""
    cell = load_cell(CELLS[0], {"rates.control_hz": control_hz, "deadlines.command_s": 0.04})

    assert cell.stale_after_s(topics.REGULATOR_TARGET) == max(3.0 / control_hz, 0.04)


@each_topic
def test_a_message_without_content_can_be_published(topic: Topic[Any]) -> None:
    """A service without data still publishes: all fields have defaults."""
    message = topic.message()

    assert message.valid
    assert topic.message(valid=False, reason="why").reason == "why"


@each_topic
def test_a_message_fits_in_a_packet_of_the_network(topic: Topic[Any]) -> None:
    """Below 1 kB on a bad day too: one Ethernet frame, no fragments."""
    every_field = topic.message.from_dict(full(topic.message))
    message = REALISTIC.get(topic.key, every_field)

    assert isinstance(message, topic.message)
    assert len(encode(HEADER, message)) < MOST_BYTES


def test_the_table_needs_no_cell_to_be_read() -> None:
    """A cell file cannot add, rename or drop a topic."""
    assert not {"topics", "requests"} & set(CellConfig.model_fields)

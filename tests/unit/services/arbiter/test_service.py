"""The arbiter on the bus: the age of every input, replies to requests, and hold before all."""

from typing import Any

import pytest

from common.bus.memory_bus import MemoryCall
from forcemesh import topics
from forcemesh.bus import Origin
from forcemesh.codec import decode_record, encode_record, pack
from forcemesh.faults import FAULTS
from forcemesh.messages import (
    ArbiterState,
)
from forcemesh.requests import ArmRequest, Empty, HoldRequest, Reply
from tests.fakes.arbiter_world import MOVE_DOWN, good_messages
from tests.fakes.bench import CELL
from tests.fakes.cellmates import Cellmates, topic_of
from tests.fakes.provoked import IN_MOTION


def test_the_arbiter_publishes_from_its_first_period(cell: Cellmates) -> None:
    """It publishes a hold with a reason before any input, and the status at once."""
    cell.messages = {}
    cell.step()
    assert cell.published().permission is None
    assert cell.newest(topics.ARBITER_STATUS).state == "BOOT"
    assert "robot/state missing" in cell.newest(topics.ARBITER_STATUS).not_ready


def test_a_command_is_published_every_period_with_its_sample(cell: Cellmates) -> None:
    """The rate is at least that of the topic; the origin is the target's."""
    cell.arm()
    for _ in range(50):
        cell.step()
        reading = cell.command.read(cell.clock.now_ns())
        assert reading.age_s == 0.0
        assert reading.origin == Origin(1234, 5)


@pytest.mark.parametrize("name", good_messages(CELL))
def test_a_silent_role_ends_the_permission_within_its_deadline(cell: Cellmates, name: str) -> None:
    """Swept: each topic in turn; not before its deadline, and at most a period after it."""
    cell.arm()
    topic = topic_of(name)
    stale_s = CELL.stale_after_s(topic)
    cell.dead.add(name)
    cell.pass_s(stale_s - cell.step_s)
    assert cell.published().permission is not None
    cell.step(2)
    assert cell.published().permission is None
    status = cell.newest(topics.ARBITER_STATUS)
    assert status.state == "FAULT"
    assert f"{topic.key} stale" in status.trips[0].text
    assert status.trips[0].code == ("sensor_silent" if name == "sensor" else "stale")

    cell.dead.clear()
    cell.pass_s(2.0)
    assert cell.published().permission is None


def test_a_change_of_state_is_published_at_once_and_else_at_the_status_rate(
    cell: Cellmates,
) -> None:
    """A client receives HOLDING in the period of the change."""
    cell.arm()
    before = cell.status.counters.received + cell.status.counters.superseded
    cell.pass_s(1.0)
    cell.newest(topics.ARBITER_STATUS)
    published = cell.status.counters.received + cell.status.counters.superseded - before
    assert published == pytest.approx(CELL.rates.status_hz, abs=2)

    assert cell.ask(topics.HOLD, HoldRequest(reason="pause")).accepted
    assert cell.newest(topics.ARBITER_STATUS).state == "HOLDING"


def test_hold_takes_precedence_in_its_period(cell: Cellmates) -> None:
    """The arm is held after any arm, clear or move of the same period."""
    cell.arm()
    cell.ask(topics.HOLD, HoldRequest())
    cell.ask_at_once(
        (topics.HOLD, HoldRequest(reason="stop")),
        (topics.CLEAR, Empty()),
        (topics.ARM, Empty()),
        (topics.MOVE, MOVE_DOWN),
    )
    assert cell.newest(topics.ARBITER_STATUS).state == "HOLDING"
    assert cell.published().permission is None
    assert "stop" in cell.published().reason


@pytest.mark.parametrize("data", [b"", b"\xc1", pack({"v": 1, "topic": "request/hold"})])
def test_a_hold_that_cannot_be_decoded_holds_first(cell: Cellmates, data: bytes) -> None:
    """The hold takes effect in that period; the reply has the error."""
    cell.arm()
    call = MemoryCall(data)
    cell.transport.serve(f"{CELL.cell}/{topics.HOLD.key}").waiting.append(call)
    cell.step()
    assert cell.newest(topics.ARBITER_STATUS).state == "HOLDING"
    assert cell.published().permission is None
    assert call.reply is not None
    reply = decode_record(call.reply, Reply)
    assert (reply.accepted, reply.code, reply.rule) == (True, "malformed", 507)
    assert "HOLDING" in reply.text
    assert "cannot be decoded: " in reply.text


def test_a_reply_is_sent_after_its_status(cell: Cellmates) -> None:
    """Once, a request after arming was refused because the reply preceded the status."""
    states: list[ArbiterState] = []
    requests = ((topics.ARM, ArmRequest()), (topics.HOLD, HoldRequest(reason="coffee")))

    class StatusRecorder(MemoryCall):
        def answer(self, data: bytes) -> None:
            """Record the status at the time of the reply."""
            MemoryCall.answer(self, data)
            states.append(cell.newest(topics.ARBITER_STATUS).state)

    cell.pass_s(1.1)
    for request, message in requests:
        waiting = cell.transport.serve(f"{CELL.cell}/{request.key}").waiting
        waiting.append(StatusRecorder(encode_record(message)))
        cell.step()
    assert states == ["ARMED", "HOLDING"]


# Faults that several messages are needed for.
PERIODS = {"misaligned": 2, "bad_messages": 6}


@pytest.mark.parametrize("code", IN_MOTION)
def test_a_fault_is_reported_in_the_first_possible_period(cell: Cellmates, code: str) -> None:
    """Swept: for each code of the list the permission ends, and the status is of this period."""
    cell.arm()
    IN_MOTION[code](cell)
    for _ in range(PERIODS.get(code, 1)):
        if code not in cell.codes():
            cell.step()
    status = cell.status.read(cell.clock.now_ns())
    assert code in cell.codes()
    assert status.age_s == 0.0
    assert (cell.published().permission is None) == (code != "goal_refused")
    (trip,) = [trip for trip in cell.last_status().trips if trip.code == code]
    assert trip.rule == FAULTS[code].rule
    assert trip.text


def test_many_requests_at_once_wait_their_turn(cell: Cellmates) -> None:
    """Four of a kind are answered in each step, in the order they came."""
    calls = [MemoryCall(encode_record(HoldRequest(reason=f"{number}"))) for number in range(6)]
    cell.transport.serve(f"{CELL.cell}/{topics.HOLD.key}").waiting.extend(calls)
    for answered in (4, 6):
        cell.step()
        assert [call.reply is not None for call in calls] == [n < answered for n in range(6)]


def test_the_service_waits_at_the_source_of_the_target(
    cell: Cellmates, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the time that is given."""
    waits = list[float]()
    reader: Any = cell.service.trigger
    monkeypatch.setattr(type(reader._source), "wait", lambda source, s: waits.append(s))
    reader.wait(0.25)
    assert waits == [0.25]

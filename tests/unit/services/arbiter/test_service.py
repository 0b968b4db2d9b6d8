"""The arbiter on the bus: every input judged by age, requests answered, hold before all."""

import msgpack
import pytest

from common.bus.memory_bus import MemoryCall
from common.config.load import cell_hash
from forcemesh import topics
from forcemesh.bus import Origin
from forcemesh.codec import decode_record, encode_record, pack
from forcemesh.messages import (
    ArbiterState,
    Health,
    RegulatorTarget,
    Speed,
    WrenchAtTcp,
)
from forcemesh.requests import ArmRequest, Empty, HoldRequest, MoveRequest, Reply
from forcemesh.version import __version__
from tests.fakes.arbiter_world import MOVE_DOWN, good_messages, shifted
from tests.fakes.bench import CELL
from tests.fakes.cellmates import Cellmates, topic_of

DEADLINE_S = CELL.deadlines.command_s


@pytest.fixture
def cell() -> Cellmates:
    """A cell where everybody lives."""
    return Cellmates()


def test_the_arbiter_speaks_from_its_first_period(cell: Cellmates) -> None:
    """Hold, with a reason, before anybody else was heard; status at once."""
    cell.messages = {}
    cell.step()
    assert cell.said().permission is None
    assert cell.newest(topics.ARBITER_STATUS).state == "BOOT"
    assert "robot/state missing" in cell.newest(topics.ARBITER_STATUS).not_ready


def test_a_command_comes_every_period_with_the_sample_behind_it(cell: Cellmates) -> None:
    """Never less often than the table promises; the origin is the target's."""
    cell.arm()
    for _ in range(50):
        cell.step()
        reading = cell.command.read(cell.clock.now_ns())
        assert reading.age_s == 0.0
        assert reading.origin == Origin(1234, 5)


@pytest.mark.parametrize("name", good_messages(CELL))
def test_a_role_that_falls_silent_ends_the_permission_within_its_deadline(
    cell: Cellmates, name: str
) -> None:
    """Swept: each topic in turn; not before its deadline, and at most a period after it."""
    cell.arm()
    topic = topic_of(name)
    stale_s = CELL.stale_after_s(topic)
    cell.dead.add(name)
    cell.pass_s(stale_s - cell.step_s)
    assert cell.said().permission is not None
    cell.step(2)
    assert cell.said().permission is None
    status = cell.newest(topics.ARBITER_STATUS)
    assert status.state == "FAULT"
    assert f"{topic.key} stale" in status.trips[0].text
    assert status.trips[0].code == ("sensor_silent" if name == "sensor" else "stale")

    cell.dead.clear()
    cell.pass_s(2.0)
    assert cell.said().permission is None


def test_a_change_of_state_is_told_at_once_and_else_at_the_status_rate(cell: Cellmates) -> None:
    """A client sees HOLDING in the period in which it happens."""
    cell.arm()
    before = cell.status.counters.received + cell.status.counters.superseded
    cell.pass_s(1.0)
    cell.newest(topics.ARBITER_STATUS)
    told = cell.status.counters.received + cell.status.counters.superseded - before
    assert told == pytest.approx(CELL.rates.status_hz, abs=2)

    assert cell.ask(topics.HOLD, HoldRequest(reason="coffee")).accepted
    assert cell.newest(topics.ARBITER_STATUS).state == "HOLDING"


def test_every_request_is_answered(cell: Cellmates) -> None:
    """Each in the state where it has something to do."""
    cell.arm()
    assert cell.ask(topics.SPEED, Speed(mechanical_m_s=0.1)).value == pytest.approx(0.1)
    assert cell.ask(topics.MOVE, MOVE_DOWN).accepted
    assert cell.said().kind == "goal"
    assert cell.said().speed.mechanical_m_s == 0.1
    assert cell.ask(topics.MOVE, MoveRequest(kind="joints")).code == "busy"
    assert cell.ask(topics.HOLD, HoldRequest()).accepted
    assert cell.ask(topics.CLEAR, Empty()).text == "cleared: the arbiter is IDLE"
    assert cell.ask(topics.MOVE, MOVE_DOWN).code == "not_armed"


def test_hold_wins_over_everything_that_comes_in_the_same_period(cell: Cellmates) -> None:
    """Whoever arms, clears or moves at that very moment: the arm is held after it."""
    cell.arm()
    cell.ask(topics.HOLD, HoldRequest())
    cell.ask_at_once(
        (topics.HOLD, HoldRequest(reason="stop")),
        (topics.CLEAR, Empty()),
        (topics.ARM, Empty()),
        (topics.MOVE, MOVE_DOWN),
    )
    assert cell.newest(topics.ARBITER_STATUS).state == "HOLDING"
    assert cell.said().permission is None
    assert "stop" in cell.said().reason


def test_a_request_that_is_no_request_is_refused_and_stops_nothing(cell: Cellmates) -> None:
    """Bytes from anybody; the arbiter goes on."""
    cell.arm()
    call = MemoryCall(b"\xc1 rubbish")
    cell.transport.serve(f"{CELL.cell}/{topics.MOVE.key}").waiting.append(call)
    cell.step()
    assert call.reply is not None
    assert b"malformed" in call.reply
    assert cell.said().permission is not None


UNREADABLE_HOLDS = {
    "empty": b"",
    "no MessagePack": b"\xc1",
    "no map": b"\x93\x01\x02\x03",
    "nested": b"\x91" * 3000,
    "another schema version": pack({"v": 1, "topic": "request/hold"}),
    "a version to come": pack({"v": 4, "reason": "stop"}),
    "written for another cell": encode_record(HoldRequest(), f"other/{topics.HOLD.key}"),
    "written for another request": encode_record(Empty(), f"{CELL.cell}/{topics.ARM.key}"),
    "a reason of 5000 characters": msgpack.packb({"reason": "x" * 5000}),
    "a reason of 501 characters": pack({"reason": "x" * 501}),
    "a reason that is a number": pack({"reason": 7}),
}


@pytest.mark.parametrize("data", UNREADABLE_HOLDS.values(), ids=UNREADABLE_HOLDS.keys())
def test_a_hold_that_cannot_be_decoded_holds_first(cell: Cellmates, data: bytes) -> None:
    """Whoever asks to hold gets a hold in that very period, then hears what was wrong."""
    cell.arm()
    call = MemoryCall(data)
    cell.transport.serve(f"{CELL.cell}/{topics.HOLD.key}").waiting.append(call)
    cell.step()
    assert cell.newest(topics.ARBITER_STATUS).state == "HOLDING"
    assert cell.said().permission is None
    assert call.reply is not None
    reply = decode_record(call.reply, Reply)
    assert (reply.accepted, reply.code, reply.rule) == (True, "malformed", 507)
    assert "HOLDING" in reply.text
    assert "cannot be decoded: " in reply.text


def test_whoever_is_answered_finds_the_status_that_says_so(cell: Cellmates) -> None:
    """Arming, then asking for force at once, was refused: the answer had overtaken the status."""
    seen: list[ArbiterState] = []
    requests = ((topics.ARM, ArmRequest()), (topics.HOLD, HoldRequest(reason="coffee")))

    class Watching(MemoryCall):
        def answer(self, data: bytes) -> None:
            """Look at the status at the moment of the answer."""
            MemoryCall.answer(self, data)
            seen.append(cell.newest(topics.ARBITER_STATUS).state)

    cell.pass_s(1.1)
    for request, message in requests:
        waiting = cell.transport.serve(f"{CELL.cell}/{request.key}").waiting
        waiting.append(Watching(encode_record(message)))
        cell.step()
    assert seen == ["ARMED", "HOLDING"]


def test_a_regulator_is_let_through_with_its_own_poses(cell: Cellmates) -> None:
    """From target to command in one period, under the lease of the person who armed."""
    cell.arm()
    cell.messages["target"] = RegulatorTarget(mode="position", pose=shifted())
    cell.step()
    command = cell.said()
    assert (command.kind, command.commander, command.pose) == ("setpoint", "regulator", shifted())
    assert command.permission is not None
    assert command.permission.deadline_s == DEADLINE_S
    cell.messages["wrench"] = WrenchAtTcp(force_N=(0.0, 0.0, 61.0))
    cell.step()
    assert cell.said().permission is None
    assert cell.newest(topics.ARBITER_STATUS).trips[0].code == "force"


def test_a_process_with_another_cell_file_is_named(cell: Cellmates) -> None:
    """By its health; the hash of the own file is told beside it."""
    cell.messages["regulator/health"] = Health(config_hash="0123456789ab", version=__version__)
    cell.pass_s(1.1)
    reply = cell.ask(topics.ARM, Empty())
    assert reply.code == "config"
    assert (
        f"regulator runs with another cell file (0123456789ab, here {cell_hash(CELL)}" in reply.text
    )

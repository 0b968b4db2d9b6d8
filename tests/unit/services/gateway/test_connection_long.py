"""Long connections: the IDs wrap many times without effect on the gateway."""

from collections import deque

import pytest

from controller import packet_table
from controller.packet import Packet, encode
from controller.packet_table import ID_FIRST, ID_LAST, TABLE, Com, Status, pack_status
from forcemesh.messages import Gains, Goal
from services.gateway.dialogue import Dialogue
from services.gateway.goals import ControllerReport, follow, sent
from tests.fakes.dialogues import GAINS, JOINTS, MS, NONE, SCALES, SPEED, at, packets

PERIOD_NS = 4 * MS
LATE_STEPS = 2
SMALL_RING = 200  # the same arithmetic with a ring that is through in a moment
RUNNING = Status.POSITION_FEEDBACK
NO_STATUS = Status(0)


class LockStep:
    """A dialogue and a controller that frames at once and takes a few steps later."""

    def __init__(self, last_id: int) -> None:
        """Exchange the hellos."""
        self.dialogue = Dialogue(SCALES, last_id=last_id)
        self.now_ns, self.sent = 0, 0
        self.status = NO_STATUS
        self._ring: deque[tuple[int, int]] = deque()  # ID, step in which it is taken
        self._step = 0
        data = self.dialogue.connected(0)
        self.taken_id = self.framed_id = packets(data)[0].id
        self.dialogue.feed(data, 0)

    def give(self, data: bytes) -> list[Packet]:
        """Let the controller frame the gateway's packets; return them."""
        if not data:
            return []
        batch = packets(data)
        for packet in batch:
            assert packet.id == packet_table.next_id(self.framed_id)
            self.framed_id = packet.id
            if packet.com == Com.HOLD:
                self._ring.clear()
            elif packet.param in TABLE[Com(packet.com)].ring:
                self._ring.append((packet.id, self._step + LATE_STEPS))
        self.sent += len(batch)
        return batch

    def step(self) -> list[Packet]:
        """Let one period pass: reports arrive, then the due packets are sent."""
        self._step += 1
        self.now_ns += PERIOD_NS
        while self._ring and self._ring[0][1] <= self._step:
            self.taken_id = self._ring.popleft()[0]
        param = pack_status(self._step, self.status)
        reports = encode(Packet(self.taken_id, Com.POSE, param))
        reports += encode(Packet(self.framed_id, Com.JOINTS, param))
        self.dialogue.feed(reports, self.now_ns)
        in_flight = self.dialogue.window.receipts.in_flight
        assert not in_flight, "a packet that was framed counts as under way"
        assert self.dialogue.window.unacknowledged == 0
        return self.give(self.dialogue.tick(self.now_ns, permitted=True))


def stream_setpoints(rig: LockStep, count: int) -> None:
    """Offer a set point each period until so many packets were sent; none may be delayed."""
    missed = 0
    while rig.sent < count:
        rig.dialogue.offer_setpoint(at(rig.sent % 100))
        missed = 0 if rig.step() else missed + 1
        assert missed <= 3, f"nothing leaves any more after {rig.sent} packets"
        assert rig.dialogue.window.unexecuted <= 1


def stream_wrenches(rig: LockStep, count: int) -> None:
    """Run force feedback: wrenches bypass the ring, so the last command taken stays the same."""
    rig.give(rig.dialogue.start_feedback(
        "position", GAINS, permitted=True, now_ns=rig.now_ns
    ))  # fmt: skip
    rig.status = RUNNING
    for _ in range(5):
        rig.step()
    target = rig.sent + count
    while rig.sent < target:
        rig.dialogue.offer_wrench((1.0, 2.0, 3.0), NONE, NONE)
        assert rig.step(), f"no wrench leaves any more after {rig.sent} packets"
        assert rig.dialogue.window.unexecuted == 0


def change_gains(rig: LockStep) -> None:
    """Send new gains: they count as taken when the controller reports it, and not before."""
    for number in (2, 3):
        rig.dialogue.offer_gains(Gains(force_p_m_per_N=(number * 1e-6,) * 3))
        assert [packet.com for packet in rig.step()] == [Com.GAINS]
        assert rig.dialogue.window.unexecuted == 1
        rig.step()
        assert rig.dialogue.window.unexecuted == 1
        for _ in range(3):
            rig.step()
        assert rig.dialogue.window.unexecuted == 0


def finish_a_goal(rig: LockStep) -> None:
    """Run a goal: it is in flight until it is taken, whatever the age of the command before."""
    rig.status = NO_STATUS
    rig.give(rig.dialogue.stop_feedback(rig.now_ns))
    rig.step()
    rig.give(rig.dialogue.move_joints(Com.MOVE_BY_JOINTS, JOINTS, SPEED, rig.now_ns))
    goal = Goal(id=1, kind="by", joint_rad=JOINTS)
    track = sent(goal, rig.dialogue.window.last, (0.0,) * 6, rig.now_ns)
    states = []
    for _ in range(5):
        rig.step()
        states.append(rig.dialogue.settled)
        track = follow(track, report_of(rig), rig.now_ns)
    assert states == [False, True, True, True, True]
    assert track.report.state == "done"


def report_of(rig: LockStep) -> ControllerReport:
    """Return the report of the connection with the arm at the end of the motion."""
    counter = rig.now_ns // PERIOD_NS
    return ControllerReport(
        at(0), JOINTS, NO_STATUS, counter, rig.dialogue.window.taken, rig.now_ns
    )


@pytest.fixture
def _small_ring(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packet_table, "ID_COUNT", SMALL_RING)


@pytest.mark.usefixtures("_small_ring")
@pytest.mark.parametrize("start", [0, 1, 99, 100, 101, 198, 199])
def test_ids_wrap_many_times_and_every_stream_continues(start: int) -> None:
    """Set points, wrenches, gains and a goal run over a dozen rings of 200 IDs."""
    rig = LockStep(ID_FIRST + start)
    stream_setpoints(rig, 4 * SMALL_RING)
    stream_wrenches(rig, 4 * SMALL_RING + start // 2)
    change_gains(rig)
    finish_a_goal(rig)
    stream_setpoints(rig, rig.sent + 2 * SMALL_RING)


@pytest.mark.usefixtures("_small_ring")
def test_a_goal_is_not_taken_early_after_any_number_of_heartbeats() -> None:
    """The last command taken may be more than a ring of packets old."""
    for beats in range(0, 2 * SMALL_RING + 50, 23):
        rig = LockStep(ID_LAST)
        rig.give(rig.dialogue.set_speed(SPEED, 0))
        for _ in range(3):
            rig.step()
        for _ in range(beats):
            rig.now_ns += 40 * MS
            rig.step()
        finish_a_goal(rig)

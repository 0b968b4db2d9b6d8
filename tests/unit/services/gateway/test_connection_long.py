"""Connections that live long: IDs go round many times, and nothing of the gateway may notice."""

import multiprocessing
import socket
from collections import deque

import pytest

from controller import packet_table
from controller.packet import PACKET_CHARS, Packet, encode
from controller.packet_table import ID_FIRST, ID_LAST, Com, Status, pack_status
from forcemesh.messages import Gains, Goal
from services.gateway.commands import Pacing
from services.gateway.connection import ControllerConnection
from services.gateway.dialogue import Dialogue
from services.gateway.goals import ControllerReport, follow, sent
from services.gateway.link import Link, LinkSettings
from services.gateway.round_trips import TAKEN
from services.gateway.scales import Scales
from tests.fakes.dialogues import GAINS, JOINTS, KEPT, MS, NONE, SCALES, SPEED, at, packets

PERIOD_NS = 4 * MS
SMALL_RING = 200  # the same arithmetic with a ring that is through in a moment
RUNNING = Status.POSITION_FEEDBACK
NO_STATUS = Status(0)


class LockStep:
    """A dialogue and a controller that frames at once and takes a few steps later."""

    def __init__(self, last_id: int, *, late_steps: int = 2, pacing: Pacing | None = None) -> None:
        """Exchange the hellos."""
        self.dialogue = Dialogue(SCALES, pacing, last_id=last_id)
        self.now_ns, self.sent = 0, 0
        self.status = NO_STATUS
        self.late_steps = late_steps
        self._ring: deque[tuple[int, int]] = deque()  # ID, step in which it is taken
        self._step = 0
        data = self.dialogue.connected(0)
        self.taken_id = self.framed_id = packets(data)[0].id
        self.dialogue.feed(data, 0)

    def give(self, data: bytes) -> list[Packet]:
        """Let the controller frame what the gateway sends."""
        if not data:
            return []
        batch = packets(data)
        for packet in batch:
            assert packet.id == packet_table.next_id(self.framed_id)
            self.framed_id = packet.id
            if packet.com == Com.HOLD:
                self._ring.clear()
            elif packet.com in TAKEN:
                self._ring.append((packet.id, self._step + self.late_steps))
        self.sent += len(batch)
        return batch

    def step(self) -> list[Packet]:
        """Let one period pass: reports come, then what is due goes out."""
        self._step += 1
        self.now_ns += PERIOD_NS
        while self._ring and self._ring[0][1] <= self._step:
            self.taken_id = self._ring.popleft()[0]
        param = pack_status(self._step, self.status)
        reports = encode(Packet(self.taken_id, Com.POSE, param))
        reports += encode(Packet(self.framed_id, Com.JOINTS, param))
        self.dialogue.feed(reports, self.now_ns)
        oldest_ns = self.dialogue.echoes.framed.oldest_ns
        assert oldest_ns is None, "a packet that was framed counts as under way"
        assert self.dialogue.unframed == 0
        return self.give(self.dialogue.tick(self.now_ns, permitted=True))


def stream_setpoints(talk: LockStep, count: int) -> None:
    """Offer a set point each period until so many packets were sent: none may be kept back."""
    missed = 0
    while talk.sent < count:
        talk.dialogue.offer_setpoint(at(talk.sent % 100))
        missed = 0 if talk.step() else missed + 1
        assert missed <= 3, f"nothing leaves any more after {talk.sent} packets"
        assert talk.dialogue.untaken <= 1


def stream_wrenches(talk: LockStep, count: int) -> None:
    """Run force feedback: wrenches pass the ring by, so the last command taken stays the same."""
    talk.give(talk.dialogue.start_feedback(
        "position", GAINS, permitted=True, now_ns=talk.now_ns
    ))  # fmt: skip
    talk.status = RUNNING
    for _ in range(5):
        talk.step()
    target = talk.sent + count
    while talk.sent < target:
        talk.dialogue.offer_wrench((1.0, 2.0, 3.0), NONE, NONE)
        assert talk.step(), f"no wrench leaves any more after {talk.sent} packets"
        assert talk.dialogue.untaken == 0


def change_gains(talk: LockStep) -> None:
    """New gains count as taken when the controller says so, neither before nor never."""
    for number in (2, 3):
        talk.dialogue.offer_gains(Gains(force_p_m_per_N=(number * 1e-6,) * 3))
        assert [packet.com for packet in talk.step()] == [Com.GAINS]
        assert talk.dialogue.untaken == 1
        talk.step()
        assert talk.dialogue.untaken == 1
        for _ in range(3):
            talk.step()
        assert talk.dialogue.untaken == 0


def finish_a_goal(talk: LockStep) -> None:
    """A goal is under way until it is taken, however long ago the command before it was."""
    talk.status = NO_STATUS
    talk.give(talk.dialogue.stop_feedback(talk.now_ns))
    talk.step()
    talk.give(talk.dialogue.move_by_joints(JOINTS, SPEED, talk.now_ns))
    goal = Goal(id=1, kind="by", joint_rad=JOINTS)
    track = sent(goal, talk.dialogue.last, (0.0,) * 6, talk.now_ns)
    states = []
    for _ in range(5):
        talk.step()
        states.append(talk.dialogue.settled)
        track = follow(track, report_of(talk), talk.now_ns)
    assert states == [False, True, True, True, True]
    assert track.report.state == "done"


def report_of(talk: LockStep) -> ControllerReport:
    """The arm at the end of `finish_a_goal`'s motion, as the connection would hand it on."""
    counter = talk.now_ns // PERIOD_NS
    return ControllerReport(at(0), JOINTS, NO_STATUS, counter, talk.dialogue.taken, talk.now_ns)


@pytest.fixture
def _small_ring(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packet_table, "ID_COUNT", SMALL_RING)


@pytest.mark.usefixtures("_small_ring")
@pytest.mark.parametrize("start", [0, 1, 99, 100, 101, 198, 199])
def test_ids_go_round_many_times_and_every_stream_goes_on(start: int) -> None:
    """Set points, wrenches, gains and a goal over a dozen rings of 200 IDs."""
    talk = LockStep(ID_FIRST + start)
    stream_setpoints(talk, 4 * SMALL_RING)
    stream_wrenches(talk, 4 * SMALL_RING + start // 2)
    change_gains(talk)
    finish_a_goal(talk)
    stream_setpoints(talk, talk.sent + 2 * SMALL_RING)


@pytest.mark.usefixtures("_small_ring")
def test_a_goal_is_not_taken_early_after_any_number_of_heartbeats() -> None:
    """The last command taken may lie any number of packets back, also more than a ring."""
    for beats in range(0, 2 * SMALL_RING + 50, 23):
        talk = LockStep(ID_LAST)
        talk.give(talk.dialogue.set_speed(SPEED, 0))
        for _ in range(3):
            talk.step()
        for _ in range(beats):
            talk.now_ns += 40 * MS
            talk.step()
        finish_a_goal(talk)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_connection_of_1200000_packets_is_as_good_as_a_new_one() -> None:
    """More than an hour at 250 Hz in the full ring, two rings and a half."""
    talk = LockStep(ID_LAST, late_steps=0)
    stream_setpoints(talk, 600_000)
    stream_wrenches(talk, 600_000)
    assert talk.sent >= 1_200_000
    talk.late_steps = 2
    change_gains(talk)
    finish_a_goal(talk)


def answer_at_once(listener: socket.socket) -> None:
    """Be a controller on a socket: frame and take whatever comes, and report it at once."""
    peer, _ = listener.accept()
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    rest, counter, greeted = b"", 0, False
    zeros = b" 000000 000000 000000 000000 000000 000000 "
    while data := peer.recv(65_536):
        rest += data
        whole = len(rest) - len(rest) % PACKET_CHARS
        if not whole:
            continue
        last, answer = rest[whole - PACKET_CHARS : whole], b""
        if not greeted:
            answer, greeted = rest[:PACKET_CHARS], True
        counter += 1
        param = b" %06d" % pack_status(counter, NO_STATUS)
        answer += last[:7] + b"000101" + param + zeros
        answer += last[:7] + b"000102" + param + zeros
        rest = rest[whole:]
        peer.sendall(answer)


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(900)
def test_a_socket_carries_600000_packets_on_one_connection() -> None:
    """No reconnection, and never a packet that seems to be under way for long."""
    listener = socket.create_server(("127.0.0.1", 0))
    process = multiprocessing.get_context("fork").Process(
        target=answer_at_once, args=(listener,), daemon=True
    )
    process.start()
    dialogue = Dialogue(Scales(), Pacing(max_untaken=2), last_id=ID_LAST)
    link = Link(LinkSettings("127.0.0.1", listener.getsockname()[1]))
    connection = ControllerConnection(link, dialogue, KEPT, stale_after_s=60.0)
    try:
        carried = carry(connection, dialogue, 600_000)
    finally:
        link.close("the test is over", 0)
        process.join(10)
        listener.close()
    assert carried >= 600_000
    assert (link.connections, connection.errors, link.last_fault) == (1, 0, "the test is over")


def carry(connection: ControllerConnection, dialogue: Dialogue, count: int) -> int:
    """Stream until so many packets were sent; time passes only when the controller has answered."""
    now_ns, first = 0, dialogue.last
    while dialogue.last - first < count:
        if connection.poll(now_ns):
            now_ns += PERIOD_NS
        if connection.is_ready:
            if not dialogue.untaken:
                dialogue.offer_setpoint(at(dialogue.last % 100))
            connection.send(dialogue.tick(now_ns, permitted=True), now_ns)
            assert dialogue.untaken <= 2
    return dialogue.last - first

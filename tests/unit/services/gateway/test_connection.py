"""Link and dialogue joined, without a socket: what is believed, what is measured, when it ends."""

import pytest

from controller.packet import Packet, encode
from controller.packet_table import ID_FIRST, PERCENT, Com, Status, pack_status
from services.gateway.connection import ControllerConnection
from services.gateway.dialogue import Dialogue
from services.gateway.link import News
from tests.fakes.dialogues import KEPT, MS, SCALES, joint_report, packets, pose_report

STALE_S = 0.1
FIT = Status.MOTOR_POWER | Status.REPEAT_MODE | Status.TEACH_LOCK_OFF | Status.PROGRAM_RUNNING


class HandWire:
    """A line whose far end is the test."""

    def __init__(self) -> None:
        """Not connected yet."""
        self.connections, self.last_fault, self.sent = 0, "", b""
        self.news = News()

    def poll(self, now_ns: int) -> News:
        """Return what the test has put there, once."""
        news, self.news = self.news, News()
        self.connections += news.opened
        return news

    def send(self, data: bytes, now_ns: int) -> bool:
        """Keep it."""
        self.sent += data
        return True

    def greeted(self) -> None:
        """Nothing to note."""

    def close(self, reason: str, now_ns: int) -> None:
        """Keep the reason."""
        self.last_fault = reason


class Talk:
    """A connection and its wire, at a time."""

    def __init__(self) -> None:
        """Not connected yet."""
        self.wire, self.now_ns = HandWire(), 0
        self.dialogue = Dialogue(SCALES)
        self.connection = ControllerConnection(
            self.wire, self.dialogue, KEPT, stale_after_s=STALE_S
        )

    def hear(self, data: bytes = b"", *, opened: bool = False, lost: str = "") -> bool:
        """Let bytes come, or the line open or end."""
        self.wire.news = News(opened, data, lost)
        return self.connection.poll(self.now_ns)

    def greet(self) -> "Talk":
        """Connect, and answer the hello with itself."""
        self.hear(opened=True)
        self.hear(self.wire.sent)
        assert self.connection.is_ready
        return self

    def report(self, counter: int = 1, status: Status = FIT) -> bool:
        """Report a sample: all that was sent is framed and taken."""
        param, id_ = pack_status(counter, status), self.dialogue.last_id
        pose = encode(Packet(id_, Com.POSE, param, (0, 20_000, 15_000, 0, 0, 0)))
        return self.hear(pose + encode(Packet(id_, Com.JOINTS, param)))


def test_what_is_lacking_is_named_in_its_order() -> None:
    """The line, the first pose, then its age with the limit."""
    talk = Talk()
    assert talk.connection.trouble(0) == "not connected to the controller yet"
    talk.greet()
    assert talk.connection.trouble(0) == "no pose from the controller yet"
    assert talk.report()
    assert talk.connection.trouble(round(STALE_S * 1e9)) == ""
    assert talk.connection.trouble(110 * MS) == (
        "the controller's pose is 110 ms old, limit 100 ms"
    )


def test_it_cannot_be_commanded_before_the_program_has_its_limits() -> None:
    """For a second that is how a connection begins; then something is wrong with the program."""
    talk = Talk().greet()
    hello = Packet(ID_FIRST, Com.POSE, pack_status(1, FIT), (0, 20_000, 15_000, 0, 0, 0))
    for at_ms, trouble, fault in (
        (0, "the controller is receiving its limits", ""),
        (999, "the controller is receiving its limits", ""),
        (1001, "", "robot_program"),
    ):
        talk.now_ns = at_ms * MS
        framed = Packet(talk.dialogue.last_id, Com.JOINTS, hello.param)
        talk.hear(encode(hello) + encode(framed))
        assert talk.connection.trouble(talk.now_ns) == trouble
        unfit = talk.connection.unfit()
        assert unfit is not None
        assert not fault or unfit.code == fault
    talk.report()
    assert talk.connection.trouble(talk.now_ns) == ""
    assert talk.connection.unfit() is None


def test_limits_that_a_hold_of_the_controllers_own_has_voided_are_told_again() -> None:
    """Framed, nothing waits, and not taken, by two reports of its health in a row."""
    talk = Talk().greet()
    before = len(packets(talk.wire.sent))
    for _ in range(3):
        talk.hear(joint_report(talk.dialogue.last_id) + encode(Packet(ID_FIRST, Com.HEALTH, 0)))
    sent = [packet.com for packet in packets(talk.wire.sent)[before:]]
    assert sent == [Com.HOLD, *[Com.LIMITS] * 4, Com.TCP]


def test_half_a_sample_is_none() -> None:
    """102 without the 101 before it says where no arm is."""
    talk = Talk().greet()
    assert not talk.hear(joint_report(talk.dialogue.last_id))
    assert talk.connection.measured is None


def test_halves_of_two_samples_close_the_link() -> None:
    """A packet is missing between them: pose and joints are not of one moment."""
    talk = Talk().greet()
    other = encode(Packet(ID_FIRST, Com.JOINTS, pack_status(2, FIT)))
    assert not talk.hear(pose_report(ID_FIRST) + other)
    assert "a packet is missing" in talk.wire.last_fault
    assert (talk.connection.errors, talk.connection.is_ready) == (1, False)
    assert "a packet is missing" in talk.connection.trouble(0)


@pytest.mark.parametrize("ends", ["closed by us", "lost"])
def test_what_was_known_ends_with_the_connection(ends: str) -> None:
    """Pose, health and rates are of one connection; the next one begins with nothing."""
    talk = Talk().greet()
    talk.report()
    if ends == "lost":
        talk.hear(lost="closed by the controller")
    else:
        talk.connection.close(talk.now_ns)
        assert talk.wire.last_fault == "closed by the gateway"
    assert talk.connection.measured is None
    assert not talk.connection.is_ready
    assert talk.connection.numbers(talk.now_ns) == {}
    unfit = talk.connection.unfit()
    assert unfit is not None
    assert unfit.code == "robot_motors"


def test_numbers_are_what_was_measured_and_no_others() -> None:
    """Rates once they were watched for a second, times once an echo came."""
    talk = Talk().greet()
    assert talk.connection.numbers(0) == {}
    for number in range(200):
        talk.now_ns += 10 * MS
        talk.report(number)
        health = (20 * number, 0, 0, 50 * PERCENT, 0, 0)
        talk.hear(encode(Packet(ID_FIRST, Com.HEALTH, 0, health)))
    numbers = talk.connection.numbers(talk.now_ns)
    assert numbers["sender_hz"] == pytest.approx(100.0)
    assert numbers["program_loop_hz"] == pytest.approx(2000.0)
    assert numbers["monitor_speed_fraction"] == pytest.approx(0.5)
    assert numbers["framed_round_trip_p99_s"] == pytest.approx(0.010)
    assert numbers["taken_round_trip_p50_s"] == pytest.approx(0.010)


def test_after_hello_come_hold_and_limits() -> None:
    """The controller's ring is emptied, and it knows what to keep to by itself."""
    set_up = [Com.LIMITS] * 4 + [Com.TCP]
    talk = Talk().greet()
    assert [packet.com for packet in packets(talk.wire.sent)] == [Com.HELLO, Com.HOLD, *set_up]

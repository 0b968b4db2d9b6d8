"""Link and dialogue joined, without a socket: accepted reports, measured numbers, and the end."""

import pytest

from controller.packet import Packet, encode
from controller.packet_table import ID_FIRST, MODES, PERCENT, Com, Status, pack_status
from forcemesh.messages import CONTROLLER_BITS
from services.gateway.connection import ControllerConnection, robot_status
from services.gateway.dialogue import Dialogue
from services.gateway.link import LinkEvents
from tests.fakes.dialogues import KEPT, MS, SCALES, joint_report, last_id, packets, pose_report

STALE_S = 0.1
FIT = Status.MOTOR_POWER | Status.REPEAT_MODE | Status.TEACH_LOCK_OFF | Status.PROGRAM_RUNNING


class ScriptedWire:
    """A line whose other end is the test."""

    def __init__(self) -> None:
        """Create an unconnected line."""
        self.connections, self.last_fault, self.sent = 0, "", b""
        self.pending = LinkEvents()

    def poll(self, now_ns: int) -> LinkEvents:
        """Return the pending news of the test, once."""
        received, self.pending = self.pending, LinkEvents()
        self.connections += received.opened
        return received

    def send(self, data: bytes, now_ns: int) -> bool:
        """Keep the bytes."""
        self.sent += data
        return True

    def greeted(self) -> None:
        """Do nothing."""

    def close(self, reason: str, now_ns: int) -> None:
        """Keep the reason."""
        self.last_fault = reason


class ConnectionRig:
    """A connection and its wire at a point in time."""

    def __init__(self) -> None:
        """Create an unconnected connection."""
        self.wire, self.now_ns = ScriptedWire(), 0
        self.dialogue = Dialogue(SCALES)
        self.connection = ControllerConnection(
            self.wire, self.dialogue, KEPT, stale_after_s=STALE_S
        )

    def receive(self, data: bytes = b"", *, opened: bool = False, lost: str = "") -> bool:
        """Deliver bytes, or open or end the line."""
        self.wire.pending = LinkEvents(opened, data, lost)
        return self.connection.poll(self.now_ns)

    def greet(self) -> "ConnectionRig":
        """Connect, and answer the hello with itself."""
        self.receive(opened=True)
        self.receive(self.wire.sent)
        assert self.dialogue.ready
        return self

    def report(self, counter: int = 1, status: Status = FIT) -> bool:
        """Report a sample in which all sent packets are framed and taken."""
        param, id_ = pack_status(counter, status), last_id(self.dialogue)
        pose = encode(Packet(id_, Com.POSE, param, (0, 20_000, 15_000, 0, 0, 0)))
        return self.receive(pose + encode(Packet(id_, Com.JOINTS, param)))


def test_missing_inputs_are_named_in_their_order() -> None:
    """The order is the line, the first pose, then the age of the pose with its limit."""
    rig = ConnectionRig()
    assert rig.connection.link_fault(0) == "not connected to the controller yet"
    rig.greet()
    assert rig.connection.link_fault(0) == "no pose from the controller yet"
    assert rig.report()
    assert rig.connection.link_fault(round(STALE_S * 1e9)) == ""
    assert rig.connection.link_fault(110 * MS) == (
        "the controller's pose is 110 ms old, limit 100 ms"
    )


def test_it_cannot_be_commanded_before_the_program_has_its_limits() -> None:
    """For one second this state is normal; later it is a fault of the program."""
    rig = ConnectionRig().greet()
    hello = Packet(ID_FIRST, Com.POSE, pack_status(1, FIT), (0, 20_000, 15_000, 0, 0, 0))
    for at_ms, link_fault, fault in (
        (0, "the controller is receiving its limits", ""),
        (999, "the controller is receiving its limits", ""),
        (1001, "", "robot_program"),
    ):
        rig.now_ns = at_ms * MS
        framed = Packet(last_id(rig.dialogue), Com.JOINTS, hello.param)
        rig.receive(encode(hello) + encode(framed))
        assert rig.connection.link_fault(rig.now_ns) == link_fault
        with_fault = rig.connection.controller_fault()
        assert with_fault is not None
        assert not fault or with_fault.code == fault
    rig.report()
    assert rig.connection.link_fault(rig.now_ns) == ""
    assert rig.connection.controller_fault() is None


def test_limits_that_a_hold_of_the_controller_has_voided_are_sent_again() -> None:
    """They are sent again when two health reports find them framed, not pending and not taken."""
    rig = ConnectionRig().greet()
    before = len(packets(rig.wire.sent))
    for _ in range(3):
        rig.receive(joint_report(last_id(rig.dialogue)) + encode(Packet(ID_FIRST, Com.HEALTH, 0)))
    sent = [packet.com for packet in packets(rig.wire.sent)[before:]]
    assert sent == [Com.HOLD, *[Com.LIMITS] * 6, Com.TCP]


def test_half_a_sample_is_none() -> None:
    """102 without the 101 before it gives no pose."""
    rig = ConnectionRig().greet()
    assert not rig.receive(joint_report(last_id(rig.dialogue)))
    assert rig.connection.measured is None


def test_halves_of_two_samples_close_the_link() -> None:
    """A packet is missing between them: pose and joints are of different samples."""
    rig = ConnectionRig().greet()
    other = encode(Packet(ID_FIRST, Com.JOINTS, pack_status(2, FIT)))
    assert not rig.receive(pose_report(ID_FIRST) + other)
    assert "a packet is missing" in rig.wire.last_fault
    assert (rig.connection.errors, rig.dialogue.ready) == (1, False)
    assert "a packet is missing" in rig.connection.link_fault(0)


@pytest.mark.parametrize("ends", ["closed by us", "lost"])
def test_measured_values_end_with_the_connection(ends: str) -> None:
    """Pose, health and rates belong to one connection; the next one begins empty."""
    rig = ConnectionRig().greet()
    rig.report()
    if ends == "lost":
        rig.receive(lost="closed by the controller")
    else:
        rig.connection.close(rig.now_ns)
        assert rig.wire.last_fault == "closed by the gateway"
    assert rig.connection.measured is None
    assert not rig.dialogue.ready
    assert rig.connection.numbers(rig.now_ns) == {}
    with_fault = rig.connection.controller_fault()
    assert with_fault is not None
    assert with_fault.code == "robot_motors"


def test_numbers_are_measured_values_only() -> None:
    """Rates appear after one second of measurement, times after the first echo."""
    rig = ConnectionRig().greet()
    assert rig.connection.numbers(0) == {}
    for number in range(200):
        rig.now_ns += 10 * MS
        rig.report(number)
        health = (20 * number, 0, 0, 50 * PERCENT, 0, 0)
        rig.receive(encode(Packet(ID_FIRST, Com.HEALTH, 0, health)))
    numbers = rig.connection.numbers(rig.now_ns)
    assert numbers["sender_hz"] == pytest.approx(100.0)
    assert numbers["program_loop_hz"] == pytest.approx(2000.0)
    assert numbers["monitor_speed_fraction"] == pytest.approx(0.5)
    assert numbers["framed_round_trip_p99_s"] == pytest.approx(0.010)
    assert numbers["taken_round_trip_p50_s"] == pytest.approx(0.010)


def test_after_hello_come_hold_and_limits() -> None:
    """The controller's ring is emptied, and its own limits are set."""
    set_up = [Com.LIMITS] * 6 + [Com.TCP]
    rig = ConnectionRig().greet()
    assert [packet.com for packet in packets(rig.wire.sent)] == [Com.HELLO, Com.HOLD, *set_up]


@pytest.mark.parametrize(("set_up", "closed_after_s"), [(False, 1.0), (True, 0.25)])
def test_a_packet_may_be_longer_in_transit_before_the_limits_are_executed(
    set_up: bool, closed_after_s: float
) -> None:
    """A slow controller reads its limits in its own time; from then on a hold must be in time."""
    rig = ConnectionRig().greet()
    if set_up:
        last = last_id(rig.dialogue)
        rig.receive(pose_report(last) + joint_report(last))
        rig.connection.send(rig.dialogue.hold(rig.now_ns), rig.now_ns)
    begun_ns = rig.now_ns
    for elapsed_s in (0.9 * closed_after_s, 1.1 * closed_after_s):
        rig.now_ns = begun_ns + round(1e3 * elapsed_s) * MS
        rig.receive()
        assert (rig.connection.code == "link_slow") == (elapsed_s > closed_after_s)
        assert rig.dialogue.ready == (elapsed_s < closed_after_s)


@pytest.mark.parametrize("name", CONTROLLER_BITS)
def test_every_status_bit_is_published_under_its_name(name: str) -> None:
    """Alone; a mode of force feedback has one or two bits."""
    status = robot_status(Status[name.upper()], 0)
    assert status.kawasaki is not None
    assert [bit for bit in CONTROLLER_BITS if getattr(status.kawasaki, bit)] == [name]
    assert (status.moving, status.held) == (name == "moving", name == "held")
    assert [robot_status(bits, 0).feedback for bits in MODES.values()] == list(MODES)


def test_an_error_of_the_controller_is_named_with_its_code() -> None:
    """The code comes with 103; until then the error has no number."""
    rig = ConnectionRig().greet()
    rig.report(1, FIT | Status.ERROR)
    assert rig.connection.status.faults[0].value != -34024
    rig.receive(encode(Packet(ID_FIRST, Com.HEALTH, -34024)))
    (fault,) = rig.connection.status.faults
    assert (fault.code, fault.value, "E4024" in fault.text) == ("robot_error", -34024, True)
    rig.report(2)
    assert rig.connection.status.ready

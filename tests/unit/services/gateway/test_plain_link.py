"""The link of protocol plain: IDs and echoes, status, holds, and wrong reports."""

import numpy as np
import pytest

from common.motion.unexplained import REACH, reach_of
from controller.packet import Packet, PacketReader, encode
from controller.packet_table import ID_FIRST, Com, Status, greeting, unpack_status
from controller.plain import ID_LAST, PlainSection
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from services.gateway.link import LinkEvents
from services.gateway.plain_link import ASSUMED, HOLD_TAKEN_WITHIN_S, PlainLink
from tests.contract.robots import plain_cell
from tests.unit.services.gateway.test_connection import ScriptedWire

STILL = (0, 0, -22_500, 0, -22_500, 0)


class LinkBench:
    """A link after hello; IDs of our packets begin at ID_FIRST."""

    def __init__(self, **overrides: object) -> None:
        cell = plain_cell(**overrides)
        assert cell.gateway is not None
        self.wire, self.chars = ScriptedWire(), cell.gateway.plain.packet_chars
        self.link = PlainLink(self.wire, cell, cell.gateway)
        self.now_ns, self.id = 0, ID_FIRST - 1
        self.wire.pending = LinkEvents(opened=True)
        self.link.poll(0)
        self.send(Com.HELLO, greeting(1), (98, 500, 250, 100, 1000, 10))
        (self.hello,) = self.poll()

    def send(self, com: Com, param: int = 0, vec=(0, 0, 0, 0, 0, 0)) -> int:
        """Send one of our packets; return its ID."""
        self.id += 1
        self.link.send(encode(Packet(self.id, com, param, vec)), self.now_ns)
        return self.id

    def sent(self) -> list[tuple[int, int, int]]:
        """Return (ID, Com, Param) of what the controller has got since the last call."""
        data, self.wire.sent = self.wire.sent, b""
        width = self.chars // 9
        numbers = [int(data[k : k + 6]) for k in range(0, len(data), width)]
        return [(numbers[k], numbers[k + 1], numbers[k + 2]) for k in range(0, len(numbers), 9)]

    def receive(self, data: bytes, *, opened: bool = False) -> None:
        """Put bytes on the wire, and open it."""
        self.wire.pending = LinkEvents(opened, self.wire.pending.data + data)

    def poll(self) -> list[Packet]:
        """Poll; return our packets."""
        return PacketReader().feed(self.link.poll(self.now_ns).data)

    def report(self, taken: int, framed: int, joints=STILL) -> tuple[int, int, Status]:
        """Let the controller report; return the IDs of our 101 and 102, and the status."""
        self.now_ns += NS_PER_S // 40
        for id_, com, vec in ((taken, 101, (0, 0, 0, 0, 0, 0)), (framed, 102, joints)):
            self.receive(encode_report(id_, com, vec, self.chars))
        pose, joint = self.poll()
        (counter, status), other = unpack_status(pose.param), unpack_status(joint.param)
        assert other == (counter, status)
        return pose.id, joint.id, status


def encode_report(id_: int, com: int, vec: tuple[int, ...], chars: int = 63) -> bytes:
    """A report, also with ID 0: no command yet."""
    gap = " " * (chars // 9 - 6)
    return "".join(f"{number:06d}{gap}" for number in (id_, com, 0, *vec)).encode()


@pytest.fixture(params=[54, 63])
def bench(request) -> LinkBench:
    """A greeted link, in both widths."""
    return LinkBench(**{"gateway.plain.packet_chars": request.param})


def test_ids_are_from_1_and_the_echoes_are_ours(bench) -> None:
    """101 echoes only what our own program would: settings and motions, not the wrench."""
    hello = ID_FIRST
    assert bench.report(0, 0)[:2] == (hello, hello)
    limits = bench.send(Com.LIMITS, 0)
    assert bench.report(0, 0)[:2] == (limits, limits)
    speed, goal = bench.send(Com.SPEEDS, 0, (10_000,) * 3 + (500, 0, 0)), bench.send(Com.MOVE_POSE)
    centre = bench.send(Com.TCP, 1)
    assert bench.sent() == [(1, 5, 0), (2, 1, 0)]
    assert bench.report(0, 1)[:2] == (limits, speed)
    assert bench.report(1, 2)[:2] == (speed, centre)
    assert bench.report(2, 2)[:2] == (centre, centre)
    wrench = bench.send(Com.WRENCH)
    assert bench.sent() == [(3, 4, 0)]
    assert bench.report(3, 3)[:2] == (centre, wrench)
    assert bench.report(2, 2)[:2] == (centre, wrench)  # older than what was echoed before
    assert goal < centre


def test_one_wrench_at_a_time_waits_to_be_taken(bench) -> None:
    """pl.main takes them in turn: a queue there would be delay."""
    bench.send(Com.WRENCH)
    bench.send(Com.WRENCH)
    assert bench.sent() == [(1, 4, 0)]
    bench.report(1, 1)
    bench.send(Com.WRENCH)
    assert bench.sent() == [(2, 4, 0)]


def test_ids_go_round_after_the_last(bench) -> None:
    """999999, then 1."""
    bench.link._number = bench.link._framed = bench.link._taken = ID_LAST - 1
    for expected in (ID_LAST, 1):
        sent = bench.send(Com.GAINS)
        assert bench.sent() == [(expected, 6, 0)]
        assert bench.report(expected, expected)[:2] == (sent, sent)


def test_status_is_what_was_commanded_and_is_taken(bench) -> None:
    """Force feedback and hold change when the echo has come; four bits are assumed."""
    assert bench.report(0, 0)[2] == ASSUMED | Status.HELD
    bench.send(Com.FEEDBACK, 0)  # 1: its speed, 2: the start
    assert bench.report(1, 2)[2] == ASSUMED | Status.HELD
    assert bench.report(2, 2)[2] == ASSUMED | Status.POSITION_FEEDBACK
    bench.send(Com.FEEDBACK, 2)
    assert bench.report(3, 3)[2] == ASSUMED
    bench.send(Com.HOLD)
    assert bench.report(4, 4)[2] == ASSUMED | Status.HELD


def test_an_arm_whose_joints_turn_is_moving(bench) -> None:
    """More than a unit in 0.1 s; at rest again 0.1 s after the last one."""
    turning = [bench.report(0, 0, (k, 0, 0, 0, 0, 0))[2] for k in (0, 1, 2, 3)]
    assert [Status.MOVING in status for status in turning] == [False, False, True, True]
    resting = [bench.report(0, 0, (3, 0, 0, 0, 0, 0))[2] for _ in range(6)]
    assert Status.MOVING not in resting[-1]


def test_reports_before_hello_are_not_passed_on() -> None:
    """Our dialogue begins with hello."""
    bench = LinkBench()
    reports = encode_report(0, 101, STILL) + encode_report(0, 102, STILL)
    bench.receive(reports, opened=True)
    assert bench.poll() == []


def test_a_hold_that_is_not_taken_closes_the_connection(bench) -> None:
    """At its end plain.as brakes; one that is taken does not."""
    bench.send(Com.MOVE_POSE)
    bench.report(1, 1)
    bench.send(Com.HOLD)
    assert bench.sent() == [(1, 1, 0), (2, 3, 0)]
    bench.now_ns += round(HOLD_TAKEN_WITHIN_S * NS_PER_S)
    bench.poll()
    assert bench.wire.last_fault == ""
    bench.now_ns += 1
    bench.poll()
    assert "not taken a hold in 500 ms" in bench.link.last_fault
    other = LinkBench()
    other.send(Com.MOVE_POSE)
    other.report(1, 1)
    other.send(Com.HOLD)
    other.report(2, 2)
    other.now_ns += 2 * NS_PER_S
    other.poll()
    assert other.wire.last_fault == ""
    other.link.close("enough", 0)
    assert other.wire.last_fault == "enough"


def test_a_hold_closes_the_connection_while_a_motion_waits_to_be_taken(bench) -> None:
    """pl.main takes its commands in turn: the motion would run before the hold behind it."""
    bench.send(Com.MOVE_POSE)
    bench.report(0, 1)
    bench.send(Com.HOLD)
    assert bench.sent() == [(1, 1, 0)]
    assert "not taken" in bench.link.last_fault


@pytest.mark.parametrize(
    ("reports", "text"),
    [
        ([(0, 102)], "101 and 102 take turns"),
        ([(0, 101), (0, 101)], "101 and 102 take turns"),
        ([(0, 101), (1, 102)], "echoes ID 1, which this connection has not sent"),
    ],
)
def test_reports_out_of_place_end_the_connection(bench, reports, text) -> None:
    """A sample is 101, then 102; an ID is one that was sent."""
    for id_, com in reports:
        bench.receive(encode_report(id_, com, STILL, bench.chars))
    with pytest.raises(RemoteProtocolError, match=text):
        bench.poll()


def test_what_cannot_be_sent_is_acknowledged_and_the_rest_is_sent(bench) -> None:
    """Our IDs have no gaps: the hold that follows must not wait for an echo that never comes."""
    stop = Packet(ID_FIRST + 2, Com.FEEDBACK, 2)
    data = encode(Packet(ID_FIRST + 1, Com.SET_POINT)) + encode(stop)
    with pytest.raises(LocalProtocolError, match="stream of set points"):
        bench.link.send(data, 0)
    assert bench.sent() == [(1, 7, 2)]
    assert bench.report(1, 1)[1] == ID_FIRST + 2


@pytest.mark.parametrize(
    ("per_mm", "per_deg", "reach_mm", "reach_deg"), [(1, 1, 1.75, 1.75), (98, 250, 0.5, 0.1719)]
)
def test_a_goal_is_done_within_the_rounding_of_the_scales(per_mm, per_deg, reach_mm, reach_deg):
    """Never nearer than in our own protocol."""
    reach = reach_of(
        PlainSection(position_per_mm=per_mm, oat_per_deg=per_deg, joint_per_deg=per_deg)
    )
    assert reach.position_m * 1e3 == pytest.approx(reach_mm)
    assert np.degrees(reach.rotation_rad) == pytest.approx(reach_deg, abs=1e-4)
    assert reach >= REACH

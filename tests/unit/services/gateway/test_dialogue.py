"""The gateway's protocol state, without a socket: order, pacing, permission, refusals."""

from math import nan

import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.packet import Packet, encode
from controller.packet_table import ID_FIRST, ID_LAST, Com, greeting
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Speed
from services.gateway.dialogue import Dialogue
from services.gateway.packets import (
    HelloReceived,
    Pacing,
)
from tests.fakes.dialogues import (
    JOINTS,
    KEPT,
    MS,
    NONE,
    SCALES,
    SPEED,
    at,
    coms,
    greeted,
    in_feedback,
    joint_report,
    last_id,
    packets,
    pose_report,
)


def test_a_controller_of_another_arm_is_refused() -> None:
    """Hello names our arm; until the controller's names it as well nothing else is sent."""
    dialogue = Dialogue(SCALES, arm=2)
    (hello,) = packets(dialogue.connected(0))
    assert (hello.com, hello.param, hello.vec) == (Com.HELLO, greeting(2), SCALES.vec)
    with pytest.raises(RemoteProtocolError, match="this is arm 1"):
        dialogue.feed(encode(Packet(ID_FIRST, Com.HELLO, greeting(1), SCALES.vec)), 0)
    assert not dialogue.ready


def test_only_hello_and_hold_are_sent_before_the_controllers_hello() -> None:
    """No number has a meaning before both ends have agreed on the scales."""
    dialogue = Dialogue(SCALES)
    with pytest.raises(LocalProtocolError, match="no connection"):
        dialogue.hold(0)
    dialogue.connected(0)
    dialogue.offer_setpoint(at(1))
    assert dialogue.tick(NS_PER_S, permitted=True) == b""
    with pytest.raises(LocalProtocolError, match="hello"):
        dialogue.move_joints(Com.MOVE_JOINTS, JOINTS, SPEED, 0)
    assert coms(dialogue.hold(0)) == [(8, 0)]


def test_speeds_go_before_goals_and_only_when_they_changed() -> None:
    """Command 5 goes before the goal; an unchanged speed is not repeated within a connection."""
    dialogue = greeted()
    slow, fast = Speed(mechanical_m_s=0.01), Speed(mechanical_m_s=0.1)
    assert coms(dialogue.move_to_pose(at(1), slow, 0)) == [(5, 0), (1, 0)]
    assert coms(dialogue.move_joints(Com.MOVE_JOINTS, JOINTS, slow, 0)) == [(2, 0)]
    assert coms(dialogue.move_joints(Com.MOVE_BY_JOINTS, JOINTS, fast, 0)) == [(5, 0), (3, 0)]
    assert coms(dialogue.set_speed(fast, 0)) == []
    dialogue.feed(dialogue.connected(0), 0)
    assert coms(dialogue.set_speed(fast, 0)) == [(5, 0)]


def test_a_refused_batch_leaves_nothing_behind() -> None:
    """When the goal does not fit, the speeds before it and its ID are not used."""
    dialogue = greeted()
    before = last_id(dialogue)
    with pytest.raises(LocalProtocolError):
        dialogue.move_to_pose(at(-5000), SPEED, 0)
    with pytest.raises(LocalProtocolError):
        dialogue.move_joints(Com.MOVE_JOINTS, (nan, 0.0, 0.0, 0.0, 0.0, 0.0), SPEED, 0)
    assert last_id(dialogue) == before
    assert coms(dialogue.move_to_pose(at(1), SPEED, 0)) == [(5, 0), (1, 0)]


def test_a_setpoint_that_is_released_in_parts_is_sent_to_its_end() -> None:
    """Each part carries the rounding of the one before; nothing is left after the last."""
    steps = [None, at(5.004), "all"]

    def release(T: pin.SE3, _: int) -> pin.SE3 | None:
        step = steps.pop(0)
        return T if step == "all" else step

    dialogue = greeted(Pacing(max_unexecuted=3, release=release))
    dialogue.offer_setpoint(at(10.008))
    assert dialogue.tick(0, permitted=True) == b""
    parts = [packets(dialogue.tick(0, permitted=True))[0].vec[0] for _ in range(2)]
    assert parts == [250, 501]  # 5.00 and 10.02 mm: 10.008 and the 0.004 mm carried
    assert dialogue.tick(0, permitted=True) == b""


@given(
    st.integers(1, 4),
    st.lists(st.sampled_from(["offer", "tick", "take", "wait"]), max_size=60),
    st.integers(ID_FIRST, ID_LAST),
)
def test_setpoints_in_flight_never_exceed_the_limit(
    limit: int, steps: list[str], last_id: int
) -> None:
    """The limit holds for every order of events, also where IDs wrap."""
    dialogue = greeted(Pacing(max_unexecuted=limit), last_id)
    now_ns, in_flight, offered = 0, [], 0
    for step in steps:
        if step == "offer":
            offered += 1
            dialogue.offer_setpoint(at(offered))
        elif step == "tick":
            sent = [
                p for p in packets(dialogue.tick(now_ns, permitted=True)) if p.com == Com.SET_POINT
            ]
            in_flight += sent
            assert all(p.vec[0] == offered * SCALES.position_per_mm for p in sent)
        elif step == "take" and in_flight:
            dialogue.feed(pose_report(in_flight.pop(0).id), now_ns)
        else:
            now_ns += 30 * MS
        assert dialogue.window.unexecuted == len(in_flight) <= limit


def test_a_heartbeat_fills_40_ms_of_silence_and_only_then() -> None:
    """Command 12 is sent 40 ms after any last packet."""
    dialogue = greeted()
    assert dialogue.tick(39 * MS, permitted=True) == b""
    assert coms(dialogue.tick(40 * MS, permitted=True)) == [(12, 0)]
    assert dialogue.tick(79 * MS, permitted=True) == b""
    dialogue.offer_setpoint(at(1))
    assert coms(dialogue.tick(79 * MS, permitted=True)) == [(13, 0)]
    assert dialogue.tick(200 * MS, permitted=True) == b""  # packets in flight count as beats
    dialogue.feed(joint_report(last_id(dialogue)), 90 * MS)
    assert dialogue.tick(118 * MS, permitted=True) == b""
    assert coms(dialogue.tick(119 * MS, permitted=True)) == [(12, 0)]


def test_without_permission_nothing_is_sent_or_kept_for_later() -> None:
    """Set points, wrenches and heartbeats are neither sent now nor after the permission returns."""
    dialogue = greeted()
    dialogue.offer_setpoint(at(1))
    for now_ms in range(0, 1000, 10):
        assert dialogue.tick(now_ms * MS, permitted=False) == b""
    assert coms(dialogue.tick(1000 * MS, permitted=True)) == [(12, 0)]
    dialogue = in_feedback()
    dialogue.offer_wrench((1.0, 0.0, 0.0), NONE, NONE)
    assert dialogue.tick(1000 * MS, permitted=False) == b""
    assert coms(dialogue.tick(1000 * MS, permitted=True)) == [(12, 0)]


def test_hold_is_command_8_and_cancels_all_motion() -> None:
    """After a hold no earlier offer is sent, and no packet is awaited."""
    dialogue = greeted()
    dialogue.offer_setpoint(at(0.005))
    dialogue.tick(0, permitted=True)
    dialogue.offer_setpoint(at(2))
    assert coms(dialogue.hold(0)) == [(8, 0)]
    assert dialogue.window.unexecuted == 0
    assert dialogue.tick(0, permitted=True) == b""
    dialogue.offer_setpoint(at(0.005))
    assert packets(dialogue.tick(0, permitted=True))[0].vec[0] == 0  # no rounding carried over


def test_a_hold_that_voids_the_limits_sends_them_again() -> None:
    """Nothing moves before the controller has the limits; after that a hold is command 8 alone."""
    dialogue = greeted()
    set_up = [(10, 0), (10, 1), (10, 2), (10, 3), (10, 4), (10, 5), (11, 0)]
    assert coms(dialogue.set_up(KEPT, 0)) == [(8, 0), *set_up]
    dialogue.feed(pose_report(last_id(dialogue) - 1), 0)
    assert not dialogue.is_set_up
    assert coms(dialogue.hold(0)) == [(8, 0), *set_up]
    dialogue.feed(pose_report(last_id(dialogue)), 0)
    assert dialogue.is_set_up
    assert coms(dialogue.hold(0)) == [(8, 0)]


def test_a_new_connection_keeps_nothing_of_the_old_one() -> None:
    """Half a packet, pending motion and running feedback end with the connection."""
    dialogue = in_feedback()
    dialogue.feed(pose_report(ID_FIRST)[:30], 0)
    hello = dialogue.connected(0)
    assert not dialogue.ready
    assert not dialogue.feedback_active
    assert isinstance(dialogue.feed(hello, 0)[0], HelloReceived)


def test_it_is_settled_when_reports_confirm_the_last_hold_and_the_last_motion() -> None:
    """A hold voids the motion before it, which then has no echo."""
    dialogue = greeted()
    assert dialogue.settled
    dialogue.move_joints(Com.MOVE_BY_JOINTS, JOINTS, SPEED, 0)
    assert not dialogue.settled
    dialogue.feed(pose_report(last_id(dialogue)), 1 * MS)
    assert dialogue.settled
    dialogue.move_joints(Com.MOVE_BY_JOINTS, JOINTS, SPEED, 2 * MS)
    dialogue.hold(3 * MS)
    assert not dialogue.settled
    dialogue.feed(joint_report(last_id(dialogue)), 4 * MS)
    assert dialogue.settled

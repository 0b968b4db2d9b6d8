"""The gateway's protocol state, without a socket: order, pacing, permission, refusals."""

from collections.abc import Callable
from math import nan

import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.packet import Packet, encode
from controller.packet_table import ID_FIRST, ID_LAST, Com, Status, greeting
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Gains, Speed
from services.gateway.dialogue import Dialogue
from services.gateway.packets import HelloReceived, Pacing
from tests.fakes.dialogues import (
    GAINS,
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


def gains_of(share: float) -> Gains:
    """Return the dialogue's gains with another proportional part."""
    return Gains(force_p_m_per_N=(share * GAINS.force_p_m_per_N[0],) * 3)


MORE = gains_of(2.0)


def test_feedback_does_not_start_without_permission() -> None:
    """The start of feedback is a motion."""
    dialogue = greeted()
    with pytest.raises(LocalProtocolError, match="permission"):
        dialogue.start_feedback("both", GAINS, permitted=False, now_ns=0)
    assert not dialogue.feedback_active


def test_motion_and_tool_are_refused_while_feedback_runs() -> None:
    """Commands 1, 2, 3, 11 and a second start are refused from the request until the end."""
    for dialogue in (greeted(), in_feedback()):
        if not dialogue.feedback_active:
            dialogue.start_feedback("position", GAINS, permitted=True, now_ns=0)
        before = last_id(dialogue)
        for refused in (
            lambda d: d.move_to_pose(at(1), SPEED, 0),
            lambda d: d.move_joints(Com.MOVE_JOINTS, JOINTS, SPEED, 0),
            lambda d: d.move_joints(Com.MOVE_BY_JOINTS, JOINTS, SPEED, 0),
            lambda d: d.offer_setpoint(at(1)),
            lambda d: d.set_centre(at(1), 0),
            lambda d: d.start_feedback("both", GAINS, permitted=True, now_ns=0),
        ):
            with pytest.raises(LocalProtocolError, match="feedback"):
                refused(dialogue)
        assert last_id(dialogue) == before


def test_feedback_that_runs_at_connection_blocks_motion_too() -> None:
    """A controller that reports running feedback is in feedback, whatever started it."""
    dialogue = greeted()
    dialogue.feed(pose_report(last_id(dialogue), Status.ORIENTATION_FEEDBACK), 0)
    with pytest.raises(LocalProtocolError, match="feedback"):
        dialogue.offer_setpoint(at(1))


def test_the_newest_wrench_goes_out_and_does_not_queue_up() -> None:
    """At most two packets are unframed; then only the newest wrench waits."""
    dialogue = in_feedback()
    sent = []
    for force_N in range(1, 6):
        dialogue.offer_wrench((float(force_N), 0.0, 0.0), NONE, NONE)
        sent += packets(dialogue.tick(0, permitted=True))
    assert [packet.vec[0] for packet in sent] == [100, 200]
    dialogue.feed(joint_report(sent[-1].id), 0)
    (last,) = packets(dialogue.tick(0, permitted=True))
    assert (last.com, last.vec[0]) == (4, 500)


def test_a_changed_set_point_goes_before_its_first_wrench() -> None:
    """Command 14 is sent once per change; the wrench is the reading itself."""
    dialogue = in_feedback()
    sent = []
    for setpoint_N in (0.0, 0.0, 10.0, 10.0, 0.0):
        dialogue.offer_wrench((0.0, 0.0, 12.0), NONE, (0.0, 0.0, setpoint_N))
        sent += packets(dialogue.tick(0, permitted=True))
        dialogue.feed(joint_report(last_id(dialogue)), 0)
    assert [(packet.com, packet.vec[2]) for packet in sent] == [
        (4, 1200), (4, 1200), (14, 1000), (4, 1200), (4, 1200), (14, 0), (4, 1200),
    ]  # fmt: skip


def test_a_set_point_whose_wrench_was_not_sent_is_sent_with_the_next() -> None:
    """The newest wrench is sent, together with the newest set point."""
    dialogue = in_feedback()
    for force_N in (1.0, 2.0):
        dialogue.offer_wrench((0.0, 0.0, force_N), NONE, NONE)
        dialogue.tick(0, permitted=True)
    for setpoint_N in (5.0, 6.0):
        dialogue.offer_wrench((0.0, 0.0, 3.0), NONE, (0.0, 0.0, setpoint_N))
        assert dialogue.tick(0, permitted=True) == b""
    dialogue.feed(joint_report(last_id(dialogue)), 0)
    sent = packets(dialogue.tick(0, permitted=True))
    assert [(packet.com, packet.vec[2]) for packet in sent] == [(14, 600), (4, 300)]


def test_the_centre_of_rotation_is_updated_one_at_a_time() -> None:
    """Command 11 goes to running feedback, the newest when the one before has been taken."""
    dialogue = in_feedback()
    dialogue.offer_centre(at(1))
    (first,) = packets(dialogue.tick(0, permitted=True))
    assert (first.com, first.param, first.vec[0]) == (11, 1, 50)
    for x_mm in (2, 3, 4):
        dialogue.offer_centre(at(x_mm))
        assert coms(dialogue.tick(0, permitted=True)) == []
    dialogue.feed(pose_report(first.id, Status.POSITION_FEEDBACK), 0)
    (last,) = packets(dialogue.tick(0, permitted=True))
    assert (last.com, last.vec[0]) == (11, 200)


@pytest.mark.parametrize("offer", [lambda d: d.offer_centre(at(1)), lambda d: d.offer_gains(MORE)])
def test_centre_and_gains_require_force_feedback_that_runs_and_is_permitted(
    offer: Callable[[Dialogue], None],
) -> None:
    """Without feedback they are refused; without permission they are dropped."""
    with pytest.raises(LocalProtocolError, match="no force feedback runs"):
        offer(greeted())
    dialogue = in_feedback()
    offer(dialogue)
    assert dialogue.tick(0, permitted=False) == b""
    assert dialogue.tick(0, permitted=True) == b""


def test_gains_that_change_faster_than_they_are_taken_do_not_queue_up() -> None:
    """Only the newest gains are sent: queued gains would delay every hold."""
    dialogue = in_feedback()
    for share in (2.0, 3.0, 4.0):
        dialogue.offer_gains(gains_of(share))
    (first,) = packets(dialogue.tick(0, permitted=True))
    assert (first.com, first.param) == (6, 0)
    for share in (5.0, 6.0, 7.0):
        dialogue.offer_gains(gains_of(share))
        assert dialogue.tick(0, permitted=True) == b""
    dialogue.feed(pose_report(first.id, Status.POSITION_FEEDBACK), 0)
    (last,) = packets(dialogue.tick(0, permitted=True))
    assert last.vec[0] / first.vec[0] == pytest.approx(7.0 / 4.0)
    dialogue.offer_gains(gains_of(7.0))
    dialogue.feed(pose_report(last.id, Status.POSITION_FEEDBACK), 0)
    assert dialogue.tick(0, permitted=True) == b""


def test_gains_do_not_wait_behind_a_moving_centre() -> None:
    """A rolling contact changes the centre at every sample; a gain reduction is still sent."""
    dialogue = in_feedback()
    dialogue.offer_gains(gains_of(2.0))
    sent = []
    for x_mm in range(4, 16, 4):
        dialogue.offer_centre(at(x_mm))
        sent += packets(dialogue.tick(0, permitted=True))
        dialogue.feed(pose_report(sent[-1].id, Status.POSITION_FEEDBACK), 0)
    assert [packet.com for packet in sent] == [6, 11, 11]

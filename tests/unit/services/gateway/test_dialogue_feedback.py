"""Force feedback in the dialogue: refusals meanwhile, and the newest of each value."""

from collections.abc import Callable

import pytest

from controller.packet_table import Com, Status
from forcemesh.errors import LocalProtocolError
from forcemesh.messages import Gains
from services.gateway.dialogue import Dialogue
from tests.fakes.dialogues import (
    GAINS,
    JOINTS,
    NONE,
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

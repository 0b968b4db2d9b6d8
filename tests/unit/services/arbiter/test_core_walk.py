"""Hold in every state, and a random sequence of all events that the arbiter can meet."""

from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from forcemesh.codec import MAX_BYTES, Header, encode
from forcemesh.faults import tripped
from forcemesh.messages import (
    MAY_MOVE,
    Accepted,
    Feedback,
    Gains,
    GoalReport,
    RegulatorTarget,
    RobotCommand,
    Speed,
)
from forcemesh.requests import MoveRequest, Reply
from tests.fakes.arbiter_world import (
    CELL,
    FIT,
    MOVE_DOWN,
    MOVE_JOINTS,
    ROBOT_FAULTS,
    STOPPED,
    World,
    distance_m,
    shifted,
    with_fault,
)

HEADER = Header(seq=1, epoch=2**62, boot="b" * 60, stamp_ns=10**15)
INPUTS = ("robot", "sensor", "wrench", "target", "hub/health", "regulator/health")
BOTHERS = ("robot", "sensor", "wrench")
LATCHED = ("HOLDING", "FAULT")
FEEDBACK = Feedback(mode="position", setpoint_force_N=(0.0, 0.0, 5.0), gains=Gains())


# --- hold -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", ["none", "operator", "regulator"])
def test_hold_stops_every_commander(motion: str) -> None:
    """It stops in the same period with the reason, and a new arming is sufficient."""
    world = World().make_armed() if motion == "none" else World().make_active(motion)
    assert world.core.hold("coffee").accepted
    command = world.tick()
    assert (command.kind, command.permission) == ("hold", None)
    assert "coffee" in command.reason
    assert world.core.state == "HOLDING"
    assert world.core.clear(world.inputs()).accepted
    assert (world.core.state, world.core.status().trips) == ("IDLE", ())


def test_hold_is_accepted_in_every_state() -> None:
    """This includes states at rest; a hold never leads to a state that may move."""
    world = World()
    for prepare, state in (
        (lambda: None, "BOOT"),
        (world.make_ready, "HOLDING"),
        (lambda: None, "HOLDING"),
        (lambda: world.core.arm(world.inputs()), "HOLDING"),
    ):
        prepare()
        assert world.core.hold("again").accepted
        assert world.core.state == state
    assert world.core.arm(world.inputs()).accepted
    world.silent.add("robot")
    world.tick()
    assert world.core.hold("again").accepted
    assert world.core.state == "FAULT"


@pytest.mark.parametrize("letter", ["x", "ж", "\U0001f916"])
def test_status_and_command_fit_for_any_length_of_reasons(letter: str) -> None:
    """Status and command can always be sent: a text must not silence the arbiter."""
    world = World().make_ready()
    for name in list(world.messages):
        world.change(name, valid=False, reason=letter * 370)
    for _ in range(12):
        world.core.hold(letter * 500)
        command = world.tick()
        assert len(encode(HEADER, command)) < MAX_BYTES / 2
        assert len(encode(HEADER, world.core.status())) < MAX_BYTES
    assert letter in world.core.status().trips[-1].text
    assert world.core.status().not_ready


class ArbiterMachine(RuleBasedStateMachine):
    """Requests and faults in any order, with the invariants checked after every step."""

    def __init__(self) -> None:
        """Start a cell."""
        super().__init__()
        self.world = World()
        self.command = self.world.tick()
        self.armed = False  # by an operator, without a stop since
        self.lease = 0

    @property
    def state(self) -> str:
        """State of the arbiter."""
        return self.world.core.state

    def note(self, reply: Reply) -> None:
        """Assert that a refusal has a reason."""
        assert reply.text
        assert reply.accepted or reply.code not in {"", "ok"}

    # --- requests -----------------------------------------------------------------------------

    @rule()
    def arm(self) -> None:
        """Arm as the operator."""
        before = self.state
        reply = self.world.core.arm(self.world.inputs())
        self.note(reply)
        if reply.accepted and before not in MAY_MOVE:
            assert before in {"IDLE", "HOLDING"}
            assert self.world.core.status().lease == self.lease + 1
            self.lease += 1
            self.armed = True

    @rule(reason=st.text(max_size=500))
    def hold(self, reason: str) -> None:
        """Hold as any client."""
        assert self.world.core.hold(reason).accepted
        self.armed = False
        assert self.state not in MAY_MOVE

    @rule()
    def clear(self) -> None:
        """Acknowledge as the operator."""
        before = self.state
        self.note(self.world.core.clear(self.world.inputs()))
        assert self.state in MAY_MOVE or not self.armed
        assert before in LATCHED or self.state == before

    @rule(
        move=st.sampled_from([MOVE_DOWN, MOVE_JOINTS, MoveRequest(kind="by")]),
        requester=st.sampled_from(["operator", "program"]),
    )
    def move(self, move: MoveRequest, requester: Any) -> None:
        """Move as an operator or a program."""
        before = self.world.core.status()
        move = move.replaced(commander=requester)
        reply = self.world.core.move(move, self.world.inputs())
        self.note(reply)
        ranks = ("none", "regulator", "program", "operator")
        holders = (before.commander, before.next_commander)
        if reply.accepted:
            assert self.armed
            assert all(ranks.index(requester) > ranks.index(holder) for holder in holders)

    @rule(speed=st.sampled_from([Speed(mechanical_m_s=0.2), Speed(mechanical_m_s=5.0)]))
    def speed(self, speed: Speed) -> None:
        """Set speeds as a program."""
        self.note(self.world.core.set_speed(speed))

    # --- surroundings ---------------------------------------------------------------------------

    @rule(name=st.sampled_from(INPUTS))
    def fall_silent(self, name: str) -> None:
        """Let an input go stale."""
        self.world.silent.add(name)

    @rule(name=st.sampled_from(BOTHERS), reason=st.text(max_size=500))
    def turn_invalid(self, name: str, reason: str) -> None:
        """Let an input report that it is invalid."""
        self.world.change(name, valid=False, reason=reason[:400])

    @rule(code=st.sampled_from(ROBOT_FAULTS))
    def report_a_fault(self, code: str) -> None:
        """Let the robot report that it is not ready."""
        self.world.change("robot", status=with_fault(code))

    @rule(force_N=st.sampled_from([0.0, 59.0, 61.0]))
    def push(self, force_N: float) -> None:
        """Let the environment push."""
        self.world.change("wrench", force_N=(0.0, 0.0, force_N))

    @rule(moving=st.booleans(), turn=st.integers(-1, 1))
    def robot_reports(self, moving: bool, turn: int) -> None:
        """Let the robot move or rest, with an echo of this or another turn."""
        turn += self.world.core.status().ownership
        echo = Accepted(epoch=1, seq=1, ownership=turn, at_ns=1)
        status = FIT.replaced(moving=moving)
        self.world.change("robot", status=status, accepted=echo)

    @rule(hold_reason=st.sampled_from(["", "out of reach"]))
    def robot_holds(self, hold_reason: str) -> None:
        """Let the robot hold by itself, or continue."""
        hold = tripped("robot_holds", hold_reason) if hold_reason else None
        self.world.change("robot", hold=hold)

    @rule(state=st.sampled_from(["running", "done", "refused"]), lag=st.integers(0, 1))
    def report(self, state: Any, lag: int) -> None:
        """Let the robot report on the present goal or an older one."""
        goal_id = 0 if self.command.goal is None else max(0, self.command.goal.id - lag)
        self.world.change("robot", goal=GoalReport(id=goal_id, state=state, reason="why"))

    @rule(x_m=st.floats(-0.02, 0.02), valid=st.booleans())
    def propose(self, x_m: float, valid: bool) -> None:
        """Let the regulator propose a pose, or fail."""
        self.world.propose(shifted(x_m=x_m), valid=valid, reason="" if valid else "cannot")

    @rule()
    def propose_feedback(self) -> None:
        """Let the regulator propose force feedback in the controller."""
        self.world.messages["target"] = RegulatorTarget(
            mode="position", host="controller", feedback=FEEDBACK
        )

    @rule()
    def stop_regulator(self) -> None:
        """Stop the regulator."""
        self.world.messages["target"] = STOPPED

    @rule()
    def restart_a_writer(self) -> None:
        """Let another process write the wrench."""
        self.world.epochs["wrench"] = self.world.epochs.get("wrench", 1) + 1

    @precondition(lambda self: self.state not in MAY_MOVE)
    @rule()
    def repair_everything(self) -> None:
        """Remove all faults, and let the preflight's second pass."""
        epochs = self.world.epochs
        self.world.silent.clear()
        self.world.messages = World().messages
        self.world.epochs = epochs
        self.world.pass_s(1.1)
        self.live(1)

    @rule(periods=st.integers(1, 5))
    def live(self, periods: int) -> None:
        """Let periods pass; compare each command with the one before."""
        for _ in range(periods):
            before, self.command = self.command, self.world.tick()
            if self.state not in MAY_MOVE:
                self.armed = False
            self.compare(before, self.command)

    def compare(self, before: RobotCommand, now: RobotCommand) -> None:
        """Assert that an operator armed before a permission and that a stream has no jump."""
        assert (now.permission is not None) == (self.state in MAY_MOVE)
        assert (now.kind == "hold") == (now.permission is None)
        if now.permission is not None:
            assert self.armed
            assert now.permission.lease == self.lease
            assert now.permission.ownership == self.world.core.status().ownership
        else:
            assert now.reason
        if before.kind == now.kind == "setpoint" and before.permission == now.permission:
            assert before.pose is not None
            assert distance_m(now.pose, before.pose) <= CELL.limits.speed_m_s * 0.004 * (1.0 + 1e-9)
        owners = {before.commander, now.commander} - {"none"}
        if before.permission is not None and now.permission is not None and len(owners) > 1:
            assert before.permission.ownership < now.permission.ownership

    # --- invariants -----------------------------------------------------------------------------

    @invariant()
    def status_agrees(self) -> None:
        """Assert that commander, trips and lease agree with the state."""
        status = self.world.core.status()
        assert (status.commander != "none") == (status.state in {"ACTIVE", "STOPPING"})
        assert (status.next_commander != "none") == (status.state == "SETTLING")
        assert status.trips or status.state not in LATCHED
        assert status.lease == self.lease
        assert self.armed == (status.state in MAY_MOVE)

    @invariant()
    def all_can_be_sent(self) -> None:
        """Assert that the messages fit after any request."""
        assert len(encode(HEADER, self.command)) < MAX_BYTES
        assert len(encode(HEADER, self.world.core.status())) < MAX_BYTES


TestArbiterMachine = ArbiterMachine.TestCase

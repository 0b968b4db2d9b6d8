"""Hold, always; and a random walk through everything that can happen to the arbiter."""

from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from common.codec import MAX_BYTES, Header, encode
from common.messages import (
    Feedback,
    Gains,
    GoalReport,
    MoveRequest,
    RegulatorTarget,
    Reply,
    RobotCommand,
    Speed,
)
from services.arbiter.inputs import PRECONDITIONS
from services.arbiter.states import MAY_MOVE
from tests.fakes.arbiter_world import (
    CELL,
    FIT,
    MOVE_DOWN,
    MOVE_JOINTS,
    STOPPED,
    World,
    shifted,
    way_m,
)

HEADER = Header(seq=1, epoch=2**62, boot="b" * 60, stamp_ns=10**15)
INPUTS = ("robot", "sensor", "wrench", "target", "hub/health", "regulator/health")
BOTHERS = ("robot", "sensor", "wrench")
LATCHED = ("HOLDING", "FAULT")
FEEDBACK = Feedback(mode="position", setpoint_force_N=(0.0, 0.0, 5.0), gains=Gains())


# --- hold -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", ["none", "operator", "regulator"])
def test_hold_stops_whoever_commands(motion: str) -> None:
    """In the same period; the reason is told, and arming again is all it takes."""
    world = World().make_armed() if motion == "none" else World().make_active(motion)
    assert world.core.hold("coffee").accepted
    command = world.tick()
    assert (command.kind, command.permission) == ("hold", None)
    assert "coffee" in command.reason
    assert world.core.state == "HOLDING"
    assert world.core.clear(world.inputs()).accepted
    assert (world.core.state, world.core.status().trips) == ("IDLE", ())


def test_hold_is_accepted_in_every_state() -> None:
    """Also where nothing moves; it never leads anywhere that could."""
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
def test_however_long_the_reasons_are_there_is_room_for_them(letter: str) -> None:
    """Status and command can always be sent: words must not silence the arbiter."""
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

"""The robot's gate: no permission, no motion, and a lost permission never comes back by itself."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.permission import CommandGate, GateDecision
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.faults import tripped
from forcemesh.messages import Accepted, Permission, RobotCommand, RobotState

DEADLINE_S = 0.04
NOW_NS = 5 * NS_PER_S
START = 7  # epoch of the robot's process
FIRST = CommandGate(START).challenge  # of its first lease


def command_reading(
    lease: int | None = 1,
    *,
    seq: int = 1,
    epoch: int = 1,
    turn: int = 0,
    age_s: float = 0.0,
    fault: str = "",
    challenge: int = FIRST,
) -> Reading[RobotCommand]:
    """Return the reading of a command; without a lease it is the arbiter's hold."""
    header = Header(
        seq=seq, epoch=epoch, boot="b", stamp_ns=1, sensor_stamp_ns=NOW_NS - 3_000_000, sensor_seq=9
    )
    if lease is None:
        return Reading(RobotCommand(reason="the arbiter is FAULT"), header, age_s, fault)
    permission = Permission(
        host="pc", lease=lease, ownership=turn, deadline_s=DEADLINE_S, challenge=challenge
    )
    return Reading(RobotCommand(kind="idle", permission=permission), header, age_s, fault)


NOTHING: Reading[RobotCommand] = Reading(None, None, float("inf"), "robot/command missing")


@pytest.fixture
def gate() -> CommandGate:
    """A robot that has just started."""
    return CommandGate(START)


def test_without_a_command_the_robot_holds(gate: CommandGate) -> None:
    """No message received yet: hold, with a reason."""
    verdict = gate.judge(NOTHING, NOW_NS)

    assert verdict == GateDecision(
        None, tripped("no_lease", "robot/command missing"), None, is_new=False
    )


@pytest.mark.parametrize(
    ("reason", "code", "shown"),
    [
        ("the force rose to 61 N", "force", ("the force rose to 61 N", "force")),
        ("", "force", ("the arbiter holds", "force")),
        ("the force rose to 61 N", "", ("the force rose to 61 N", "hold")),
        ("", "", ("the arbiter holds", "hold")),
    ],
)
def test_a_hold_of_the_arbiter_keeps_its_reason_and_its_code(
    gate: CommandGate, reason: str, code: str, shown: tuple[str, str]
) -> None:
    """The robot reports the arbiter's own fault; where that names none, that the arbiter holds."""
    held = command_reading(None)._replace(message=RobotCommand(reason=reason, code=code))
    verdict = gate.judge(held, NOW_NS)

    assert (verdict.hold_reason, verdict.hold_code) == shown
    assert (verdict.command, verdict.is_new) == (None, False)


def test_a_fresh_command_with_a_permission_is_obeyed_and_echoed(gate: CommandGate) -> None:
    """The echo carries commander, permission, time, and the sensor sample behind it."""
    reading = command_reading(seq=4, epoch=2)
    verdict = gate.judge(reading, NOW_NS)

    echo = Accepted(epoch=2, seq=4, at_ns=NOW_NS, sensor_stamp_ns=NOW_NS - 3_000_000, sensor_seq=9)
    assert verdict == GateDecision(reading.message, None, echo, is_new=True)


def test_the_same_command_is_new_only_once(gate: CommandGate) -> None:
    """Judged each period, it is obeyed as long as it is fresh, but taken once."""
    assert gate.judge(command_reading(), NOW_NS).is_new
    again = gate.judge(command_reading(age_s=0.01), NOW_NS + 1)
    assert again.command is not None
    assert not again.is_new
    assert again.accepted is not None
    assert again.accepted.at_ns == NOW_NS
    assert gate.judge(command_reading(seq=2), NOW_NS + 2).is_new


def test_a_permission_counts_up_to_its_deadline_and_not_beyond(gate: CommandGate) -> None:
    """The boundary is exact, and the hold gives both numbers."""
    assert gate.judge(command_reading(age_s=DEADLINE_S), NOW_NS).command is not None
    late = gate.judge(command_reading(age_s=DEADLINE_S + 1e-9), NOW_NS)
    assert (late.command, late.hold_reason) == (None, "permission 40 ms old, limit 40 ms")


@pytest.mark.parametrize(
    "missed",
    [
        NOTHING,
        command_reading(age_s=1.0),
        command_reading(fault="robot/command stale: 50 ms old"),
        command_reading(fault="robot/command invalid: no reason given"),
        command_reading(None, seq=2),
    ],
    ids=["missing", "late", "stale", "invalid", "held"],
)
def test_a_missed_deadline_ends_the_lease_for_good(
    gate: CommandGate, missed: Reading[RobotCommand]
) -> None:
    """After a missed deadline, or a hold, only a new lease moves the arm: a person armed again."""
    assert gate.judge(command_reading(seq=1), NOW_NS).command is not None
    assert gate.judge(missed, NOW_NS).command is None
    for seq in range(3, 50):
        verdict = gate.judge(command_reading(seq=seq), NOW_NS)
        assert verdict.command is None
        assert verdict.hold_reason.startswith("lease 1 ended: ")
    again = command_reading(lease=2, seq=50, challenge=gate.challenge)
    assert gate.judge(again, NOW_NS).command is not None


@pytest.mark.parametrize("challenge", [0, FIRST - 1, CommandGate(START + 1).challenge])
def test_a_robot_that_has_known_no_arbiter_executes_nothing_of_another_life(
    gate: CommandGate, challenge: int
) -> None:
    """Without a challenge, or with that of another start, of a message that is fresh and whole."""
    assert gate.challenge == FIRST
    verdict = gate.judge(command_reading(lease=9, challenge=challenge), NOW_NS)
    assert (verdict.command, verdict.hold_code, verdict.accepted) == (None, "no_lease", None)
    assert str(challenge) in verdict.hold_reason
    assert gate.challenge == FIRST  # nothing was alive, so nothing has died
    assert gate.judge(command_reading(), NOW_NS).command is not None


def test_a_challenge_is_never_repeated() -> None:
    """Each start and each dead lease has its own, and JSON carries it without rounding."""
    drawn = []
    for epoch in range(30):
        gate = CommandGate(epoch)
        for _ in range(30):
            drawn.append(gate.challenge)
            gate.judge(command_reading(challenge=gate.challenge), NOW_NS)
            gate.judge(NOTHING, NOW_NS)
    assert len(set(drawn)) == len(drawn)
    assert all(0 < challenge < 2**53 for challenge in drawn)


def test_the_robot_itself_can_end_a_lease(gate: CommandGate) -> None:
    """Asked for a motion that it cannot do, it holds until a person arms again."""
    gate.judge(command_reading(), NOW_NS)
    assert gate.revoke(tripped("robot_refuses", "out of reach")).hold_reason == "out of reach"
    assert gate.judge(command_reading(seq=2), NOW_NS).hold_reason == "lease 1 ended: out of reach"


def test_a_hold_always_has_a_reason_that_fits_a_message(gate: CommandGate) -> None:
    """However it came about, and however long the words were."""
    gate.judge(command_reading(), NOW_NS)
    verdicts = [
        gate.revoke(tripped("robot_refuses", "y" * 500)),
        gate.judge(command_reading(seq=2), NOW_NS),
        gate.judge(Reading(None, None, 0.0, ""), NOW_NS),
        gate.judge(command_reading(lease=None), NOW_NS),
    ]
    for verdict in verdicts:
        assert verdict.command is None
        assert RobotState(hold=verdict.hold).hold_reason


@given(st.lists(st.tuples(st.integers(1, 3), st.integers(0, 3)), min_size=1, max_size=12))
def test_turns_of_a_lease_never_go_back(published: list[tuple[int, int]]) -> None:
    """A command is accepted if none before it is newer; an older one ends the lease for good."""
    gate = CommandGate(START)
    newest, live = (0, 0), NOTHING
    for seq, (lease, turn) in enumerate(published, start=1):
        reading = command_reading(lease, seq=seq, turn=turn, challenge=gate.challenge)
        verdict = gate.judge(reading, NOW_NS)
        obeyed = (lease, turn) >= newest
        assert (verdict.command is not None) == obeyed
        if obeyed:
            newest, live = (lease, turn), reading
            assert verdict.accepted is not None
            assert verdict.accepted.ownership == turn
        else:
            assert gate.judge(live, NOW_NS).command is None


@pytest.mark.parametrize("why", ["two writers", "late"])
def test_a_turn_that_was_received_and_refused_ends_the_ones_before_it_all_the_same(
    gate: CommandGate, why: str
) -> None:
    """While two processes write, no command is executed; afterwards an older turn is over."""
    newest = command_reading(lease=5, turn=2, age_s=2 * DEADLINE_S if why == "late" else 0.0)
    assert gate.judge(newest._replace(conflict=why == "two writers"), NOW_NS).command is None
    for lease, turn in ((4, 9), (5, 1)):
        verdict = gate.judge(command_reading(lease=lease, turn=turn, seq=2), NOW_NS)
        assert (verdict.command, verdict.hold_code) == (None, "no_lease")
    assert gate.judge(command_reading(lease=5, turn=2, seq=3), NOW_NS).command is not None

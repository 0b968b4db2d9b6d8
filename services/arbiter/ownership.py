"""Ownership of the arm, its pending move, and the time at rest between two owners. Pure."""

from dataclasses import dataclass

from forcemesh.clock import NS_PER_S
from forcemesh.messages import Asker, Commander, Goal, Host, RobotState, Speed
from forcemesh.requests import MoveRequest
from services.arbiter.stream import SetpointStream

REST_S = 0.1  # time at rest before a hand-over, besides three of the robot's reports
SETTLE_WITHIN_S = 3.0  # longest time from the request to the arm at rest


@dataclass(frozen=True, slots=True)
class Ownership:
    """Ownership period: without an owner at first, then one owner's until its command ends.

    Its number goes out in the permission as a fencing token. The robot echoes it: once the new
    number is reported, no command of the previous owner is in flight.
    """

    number: int = 0
    commander: Commander = "none"
    host: Host = "pc"  # where the regulator runs
    goal: Goal | None = None
    speed: Speed | None = None  # of this goal
    stream: SetpointStream | None = None  # of the regulator's set points

    def next(self) -> "Ownership":
        """Return the next ownership period, without an owner yet."""
        return Ownership(self.number + 1)


@dataclass(frozen=True, slots=True)
class PendingMove:
    """Pending move, which begins when the arm is at rest."""

    commander: Asker
    request: MoveRequest
    goal: Goal
    speed: Speed
    since_ns: int


@dataclass(frozen=True, slots=True)
class Rest:
    """Time since which the robot has reported rest under the present turn number."""

    since_ns: int | None = None

    def update(self, robot: RobotState | None, ownership: Ownership, now_ns: int) -> "Rest":
        """Return the state after another report; a robot that holds accepts no owner: no rest.

        A robot that has never accepted a command has no turn number to compare.
        """
        if robot is None or ownership.commander != "none" or robot.hold is not None:
            return Rest()
        status, echo = robot.status, robot.accepted
        if status.moving or status.feedback is not None:
            return Rest()
        if echo is not None and echo.ownership != ownership.number:
            return Rest()
        return Rest(now_ns) if self.since_ns is None else self

    def lasts_s(self, now_ns: int) -> float:
        """Return the time at rest [s], -1 while the arm is not at rest."""
        return -1.0 if self.since_ns is None else (now_ns - self.since_ns) / NS_PER_S

"""Who has the arm, who waits for it, and since when it is at rest. Pure."""

from dataclasses import dataclass

from forcemesh.clock import NS_PER_S
from forcemesh.messages import Asker, Commander, Goal, Host, RobotState, Speed
from forcemesh.requests import MoveRequest
from services.arbiter.stream import Stream

REST_S = 0.1  # the arm must have been at rest for so long, and for three of the robot's reports
SETTLE_WITHIN_S = 3.0  # of the wish to begin


@dataclass(frozen=True, slots=True)
class Turn:
    """From one end of somebody's command to the next: nobody's at first, then one owner's.

    Each has its own number in the permission. The robot echoes it: once the new number comes back,
    nothing of the last owner is on its way any more.
    """

    number: int = 0
    commander: Commander = "none"
    host: Host = "pc"  # where the regulator runs
    goal: Goal | None = None
    speed: Speed | None = None  # of this goal
    stream: Stream | None = None  # of the regulator's set points

    def next(self) -> "Turn":
        """Return the turn after this one: nobody's yet."""
        return Turn(self.number + 1)


@dataclass(frozen=True, slots=True)
class Claim:
    """A move that begins when the arm is at rest."""

    commander: Asker
    request: MoveRequest
    goal: Goal
    speed: Speed
    since_ns: int


@dataclass(frozen=True, slots=True)
class Rest:
    """Since when the robot has said, under the present turn, that it rests."""

    since_ns: int | None = None

    def seen(self, robot: RobotState | None, turn: Turn, now_ns: int) -> "Rest":
        """Return the rest after another look; a robot that holds obeys nobody and does not count.

        A robot that has never accepted a command is not moving for us.
        """
        if robot is None or turn.commander != "none" or robot.hold is not None:
            return Rest()
        status, echo = robot.status, robot.accepted
        if status.moving or status.feedback is not None:
            return Rest()
        if echo is not None and echo.ownership != turn.number:
            return Rest()
        return Rest(now_ns) if self.since_ns is None else self

    def lasts_s(self, now_ns: int) -> float:
        """Return how long the arm has been at rest [s]; minus one while it is not."""
        return -1.0 if self.since_ns is None else (now_ns - self.since_ns) / NS_PER_S

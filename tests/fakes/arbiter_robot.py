"""An arbiter and a robot that receives late, takes time to stop, and reports it."""

from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from forcemesh.faults import tripped
from forcemesh.messages import (
    Accepted,
    Feedback,
    Gains,
    GoalReport,
    PoseRecord,
    RobotCommand,
    RobotState,
)
from forcemesh.requests import MoveRequest, Reply
from tests.fakes.arbiter_world import (
    FIT,
    MOVE_DOWN,
    PERIOD_NS,
    STOPPED,
    World,
    distance_m,
    shifted,
)

FEEDBACK = Feedback(mode="position", setpoint_force_N=(0.0, 0.0, 5.0), gains=Gains())
MOTIONS = {"goal", "setpoint", "feedback"}


@dataclass
class RobotWorld(World):
    """The arbiter's surroundings with a robot."""

    lag_periods: int = 4  # from a command to the report that shows it
    brake_periods: int = 15
    commands: list[RobotCommand] = field(default_factory=list)
    began_moving: list[bool] = field(default_factory=list)  # as each of them was given

    def __post_init__(self) -> None:
        """Start with a robot that holds."""
        super().__post_init__()
        self._in_transit: deque[RobotCommand] = deque([RobotCommand()] * self.lag_periods)
        self._braking = 0

    @property
    def robot(self) -> RobotState:
        """Last reported state of the robot."""
        robot = self.messages["robot"]
        assert isinstance(robot, RobotState)
        return robot

    @property
    def set_points(self) -> list[PoseRecord]:
        """Every commanded pose."""
        streamed = [command for command in self.commands if command.kind == "setpoint"]
        return [command.pose for command in streamed if command.pose is not None]

    @property
    def travels_m(self) -> list[float]:
        """Travel of each set point from the one before."""
        return [distance_m(b, a) for a, b in pairwise(self.set_points)]

    def tick(self, times: int = 1, *, period_ns: int = PERIOD_NS) -> RobotCommand:
        """Advance by periods; return the last command."""
        command = RobotCommand()
        for _ in range(times):
            self.began_moving.append(self.robot.status.moving)
            command = super().tick(period_ns=period_ns)
            self.commands.append(command)
            self._in_transit.append(command)
            self._obey(self._in_transit.popleft())
        return command

    def _obey(self, command: RobotCommand) -> None:
        if command.permission is None:
            self.change("robot", hold=tripped("robot_holds", "the arbiter holds"))
        else:
            echo = Accepted(epoch=1, seq=1, ownership=command.permission.ownership, at_ns=1)
            self.change("robot", hold=None, accepted=echo)
        self._braking = self.brake_periods if command.kind in MOTIONS else self._braking - 1
        moving = self._braking > 0 or command.kind in MOTIONS
        update = {"moving": moving, "feedback": command.feedback and command.feedback.mode}
        self.change("robot", status=FIT.replaced(**update))
        if command.kind == "setpoint" and command.pose is not None:
            pose = command.pose
            self.change("robot", position_m=pose.position_m, orientation_xyzw=pose.orientation_xyzw)
        if command.goal is not None and command.goal.id != self.robot.goal.id:
            self.change("robot", goal=GoalReport(id=command.goal.id, state="running"))

    # --- who asks ---------------------------------------------------------------------------------

    def ask(self, commander: Any) -> Reply | None:
        """Let a commander request the arm; the regulator requests it by its target."""
        if commander == "regulator":
            self.propose(shifted(z_m=-0.01))
        elif commander == "controller":
            self.propose(None, host="controller", feedback=FEEDBACK)
        else:
            request: MoveRequest = MOVE_DOWN.replaced(commander=commander)
            return self.core.move(request, self.inputs())
        return None

    def make_armed(self) -> "RobotWorld":
        """Arm and wait until the robot accepts."""
        super().make_armed()
        return self

    def give(self, commander: Any) -> "RobotWorld":
        """Give the arm to a commander and begin a motion."""
        self.make_armed()
        self.ask(commander)
        self.tick(60)
        assert self.core.status().commander == commander.replace("controller", "regulator")
        assert self.robot.status.moving
        return self

    def stop_the_regulator(self) -> None:
        """Stop the regulator's target, as it does when another commander takes the arm."""
        if self.core.state in {"SETTLING", "STOPPING", "HOLDING"}:
            self.messages["target"] = STOPPED

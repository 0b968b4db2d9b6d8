"""An arbiter with a robot that hears late, takes its time to stop, and says so."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from forcemesh.faults import tripped
from forcemesh.messages import (
    Accepted,
    Feedback,
    Gains,
    GoalReport,
    RobotCommand,
    RobotState,
)
from forcemesh.requests import MoveRequest, Reply
from tests.fakes.arbiter_world import FIT, MOVE_DOWN, PERIOD_NS, STOPPED, World, shifted

FEEDBACK = Feedback(mode="position", setpoint_force_N=(0.0, 0.0, 5.0), gains=Gains())
MOTIONS = {"goal", "setpoint", "feedback"}


@dataclass
class RobotWorld(World):
    """The arbiter's surroundings, with a robot among them."""

    lag_periods: int = 4  # from a command to the report that shows it
    brake_periods: int = 15
    commands: list[RobotCommand] = field(default_factory=list)
    began_moving: list[bool] = field(default_factory=list)  # as each of them was given

    def __post_init__(self) -> None:
        """Start with a robot that holds."""
        super().__post_init__()
        self._heard: deque[RobotCommand] = deque([RobotCommand()] * self.lag_periods)
        self._braking = 0

    @property
    def robot(self) -> RobotState:
        """What the robot says."""
        robot = self.messages["robot"]
        assert isinstance(robot, RobotState)
        return robot

    def tick(self, times: int = 1, *, period_ns: int = PERIOD_NS) -> RobotCommand:
        """Let periods pass; return the last command."""
        command = RobotCommand()
        for _ in range(times):
            self.began_moving.append(self.robot.status.moving)
            command = super().tick(period_ns=period_ns)
            self.commands.append(command)
            self._heard.append(command)
            self._obey(self._heard.popleft())
        return command

    def _obey(self, command: RobotCommand) -> None:
        if command.permission is None:
            self.change("robot", hold=tripped("robot_holds", "the arbiter holds"))
        else:
            echo = Accepted(epoch=1, seq=1, ownership=command.permission.ownership, at_ns=1)
            self.change("robot", hold=None, accepted=echo)
        self._braking = self.brake_periods if command.kind in MOTIONS else self._braking - 1
        moving = self._braking > 0 or command.kind in MOTIONS
        update = {"moving": moving, "position_feedback": command.kind == "feedback"}
        self.change("robot", status=FIT.model_copy(update=update))
        if command.kind == "setpoint" and command.pose is not None:
            pose = command.pose
            self.change("robot", position_m=pose.position_m, orientation_xyzw=pose.orientation_xyzw)
        if command.goal is not None and command.goal.id != self.robot.goal.id:
            self.change("robot", goal=GoalReport(id=command.goal.id, state="running"))

    # --- who asks ---------------------------------------------------------------------------------

    def ask(self, commander: Any) -> Reply | None:
        """Let somebody ask for the arm; the regulator does it by its target."""
        if commander == "regulator":
            self.propose(shifted(z_m=-0.01))
        elif commander == "controller":
            self.propose(None, host="controller", feedback=FEEDBACK)
        else:
            wish: MoveRequest = MOVE_DOWN.model_copy(update={"commander": commander})
            return self.core.move(wish, self.inputs())
        return None

    def make_armed(self) -> "RobotWorld":
        """Arm, and let the robot accept."""
        super().make_armed()
        return self

    def give(self, commander: Any) -> "RobotWorld":
        """Let somebody have the arm, and move it."""
        self.make_armed()
        self.ask(commander)
        self.tick(60)
        assert self.core.status().commander == commander.replace("controller", "regulator")
        assert self.robot.status.moving
        return self

    def stop_the_regulator(self) -> None:
        """Do as the regulator does when somebody else commands."""
        if self.core.state in {"SETTLING", "STOPPING", "HOLDING"}:
            self.messages["target"] = STOPPED

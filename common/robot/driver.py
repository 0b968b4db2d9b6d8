"""Driver of a robot: the part of the role `robot` that differs from arm to arm.

An arm has three doors: `report` reads its state, `stream` follows set points, `goal` executes a
move. `RobotService` has checked what passes through them, and calls `hold` when nothing may move.
The other methods have a default for an arm that has no such thing.
"""
# ruff: noqa: B027 - a default that does nothing is an empty method

from abc import ABC, abstractmethod
from collections.abc import Sequence

import pinocchio as pin

from common.robot.report import ArmReport
from common.runtime.signal_service import SignalReading
from forcemesh.faults import tripped
from forcemesh.messages import (
    Feedback,
    Goal,
    GoalState,
    LinkHealth,
    PoseRecord,
    RobotCommand,
    RobotStatus,
    Speed,
    Trip,
    WrenchAtTcp,
)

NO_REPORT = tripped("robot_link", "the robot has not reported its pose yet")
NO_FEEDBACK = tripped(
    "robot_refuses",
    "force feedback in the controller requires a controller; this robot has none",
)
NO_SIGNALS = tripped("robot_refuses", "this robot has no digital signals")


class RobotDriver(ABC):
    """One arm, as `RobotService` commands it.

    A step is `receive`, the command or `hold`, and `report`. A command that cannot be encoded
    raises LocalProtocolError, which ends the lease.
    """

    link_fault: Trip | None = NO_REPORT  # why the state of the arm is not known
    arm_fault: Trip | None = None  # why the arm would not follow a command
    link = LinkHealth(connected=True, round_trip_s=0.0)
    status: RobotStatus | None = None  # None: ready, without a fault

    # --- report -----------------------------------------------------------------------------------

    @abstractmethod
    def receive(self, now_ns: int) -> None:
        """Begin a step at this time: take in what the arm has sent, and set faults and status."""

    @property
    @abstractmethod
    def measured(self) -> ArmReport | None:
        """Newest state of the arm; None: not known."""

    @abstractmethod
    def report(self) -> Sequence[ArmReport]:
        """Return the new reports of this step, oldest first."""

    @property
    def explains_motion(self) -> bool:
        """Whether the arm may move without goal and stream: braking, feedback, guided by hand."""
        return False

    # --- stream -----------------------------------------------------------------------------------

    @abstractmethod
    def stream(self, T_base_flange: pin.SE3, *, begins: bool) -> Trip | None:
        """Follow a set point, or return why not. A stream begins at the measured pose."""

    def sent(self, setpoint: PoseRecord) -> PoseRecord | None:
        """Return the set point that the arm was given; `setpoint` is the newest one."""
        return setpoint

    # --- goal -------------------------------------------------------------------------------------

    @abstractmethod
    def goal(self, goal: Goal, speed: Speed) -> str:
        """Start a goal; return why it is refused, empty when it runs."""

    @abstractmethod
    def goal_state(self) -> tuple[GoalState, str]:
        """Return the state of the goal that runs, and why it is refused."""

    # --- both -------------------------------------------------------------------------------------

    def may_begin(self, kind: str) -> bool:  # noqa: ARG002 - of an override
        """Return whether a stream, or a goal of this kind, may begin: nothing before it moves."""
        return True

    @abstractmethod
    def hold(self, *, begins: bool) -> None:
        """Brake as it begins; nothing sent before may move the arm later.

        Called in every step of a hold, and once when a goal ends other than done.
        """

    def feed_back(
        self,
        feedback: Feedback,  # noqa: ARG002 - of an override
        wrench: WrenchAtTcp,  # noqa: ARG002
        sample: tuple[int, int],  # noqa: ARG002
    ) -> Trip | None:
        """Start, feed or change force feedback in the controller; return why it cannot run.

        `sample` is epoch and number of the wrench: each is to be sent once.
        """
        return NO_FEEDBACK

    def flush(self, command: RobotCommand, wrench: WrenchAtTcp | None) -> None:
        """Send what is due under a permitted command, after its door."""

    # --- signals ----------------------------------------------------------------------------------

    def signals(self) -> SignalReading:
        """Return the state of the digital signals, or why it is unknown."""
        return SignalReading(code=NO_SIGNALS.code, reason=NO_SIGNALS.text)

    def switch(self, number: int, on: bool) -> Trip | None:  # noqa: ARG002, FBT001 - a `Switch`
        """Switch an output, or return why not."""
        return NO_SIGNALS

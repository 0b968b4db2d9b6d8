"""Moves of the flange and the joints: request, then wait for arrival."""

from collections.abc import Callable
from typing import Literal, NoReturn

from forcemesh import topics
from forcemesh.client import rotations as turning
from forcemesh.client.ask import remedy_of, stopped_error
from forcemesh.client.session import ClientSession
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ArmStoppedError, LostError, NotReachedError, RefusedError
from forcemesh.messages import (
    ZERO3,
    ArbiterStatus,
    Joints,
    PoseRecord,
    Quaternion,
    RobotState,
    Vec3,
)
from forcemesh.requests import HoldRequest, MoveRequest

MOVE_POLL_S = 0.02
TAKEN_S = 0.5  # a change of goal in arbiter/status counts after this time
MOVE_STATE_WITHIN_S = 2.0
LONGEST_MOVE_S = 120.0
AFTERWARDS_S = 0.2  # longest time until the arbiter reports why a goal ended
RETRACT_M, RETRACT_M_S = 0.010, 0.010
STOPPED = ("HOLDING", "FAULT")
ENDED = "the move ended before its goal"

Progress = Callable[[RobotState], None]


class Move:
    """One accepted move under way."""

    def __init__(self, session: ClientSession, number: int) -> None:
        """Track the goal with this number."""
        self.id = number
        self.began = False
        self._session, self._clock = session, session.clock
        self._robot = session.feed(topics.ROBOT_STATE)
        self._arbiter = session.feed(topics.ARBITER_STATUS)
        self._mine_ns = self._clock.now_ns()  # last time that the arbiter reported this goal

    def wait(
        self, timeout_s: float = LONGEST_MOVE_S, progress: Progress | None = None
    ) -> RobotState:
        """Wait for arrival and return the robot state. Ctrl-C or a timeout holds the arm.

        Raises:
            RefusedError: The robot cannot reach the goal.
            ArmStoppedError: The arm was stopped, or another commander took it.
            NotReachedError: The move ended before its goal, or took too long.
            LostError: No messages from the robot.
        """
        try:
            return self._follow(timeout_s, progress)
        except KeyboardInterrupt:
            self._session.ask(topics.HOLD, HoldRequest(reason="move was interrupted"))
            raise
        except TimeoutError as error:
            self._session.ask(topics.HOLD, HoldRequest(reason="a move took too long"))
            raise NotReachedError(str(error)) from None

    def _follow(self, timeout_s: float, progress: Progress | None) -> RobotState:
        started_ns = received_ns = self._mine_ns = self._clock.now_ns()
        while True:
            self._clock.sleep_s(MOVE_POLL_S)
            now_ns = self._clock.now_ns()
            if now_ns - started_ns > timeout_s * NS_PER_S:
                raise TimeoutError(f"move not complete within {timeout_s:g} s; the arm holds")
            reading = self._robot.reading()
            if reading.fresh is None:
                if now_ns - received_ns > MOVE_STATE_WITHIN_S * NS_PER_S:
                    raise self._session.lost(f"no state of the arm: {reading.fault}")
                continue
            received_ns = now_ns
            if progress is not None:
                progress(reading.fresh)
            if self._is_done(reading.fresh):
                return reading.fresh
            self._raise_when_stopped(now_ns)

    def _is_done(self, robot: RobotState) -> bool:
        if robot.goal.id != self.id:
            return False
        if robot.goal.state == "refused":
            self._raise_refusal(robot.goal.reason)
        self.began = self.began or robot.goal.state == "running"
        if robot.goal.state != "done":
            return False
        # Until the arbiter has registered arrival, it refuses the next move.
        status = self._arbiter.reading().fresh
        return status is None or status.goal_id != self.id

    def _raise_refusal(self, reason: str) -> NoReturn:
        """Raise the reason of a failed move; for a stopped arm the arbiter's reason is better."""
        end_ns = self._clock.now_ns() + round(AFTERWARDS_S * NS_PER_S)
        while self._clock.now_ns() < end_ns:
            status = self._arbiter.reading().fresh
            if status is not None and status.state in STOPPED:
                raise stopped_error(status, ENDED)
            if status is not None and status.goal_id > self.id:
                raise _taken(status)
            self._clock.sleep_s(MOVE_POLL_S)
        if self.began:
            raise NotReachedError(f"{ENDED}: {reason}")
        raise RefusedError("goal_refused", reason, remedy=remedy_of("goal_refused"))

    def _raise_when_stopped(self, now_ns: int) -> None:
        """Raise when the arm was stopped or has another owner: this goal cannot resume."""
        status = self._arbiter.reading().fresh
        if status is None or status.goal_id == self.id:
            self._mine_ns = now_ns
        elif status.state in STOPPED:
            raise stopped_error(status, ENDED)
        elif now_ns - self._mine_ns > TAKEN_S * NS_PER_S:
            raise _taken(status)


def _taken(status: ArbiterStatus) -> ArmStoppedError:
    """Return the exception of a move that another commander or move has replaced."""
    why = "; ".join(trip.text for trip in status.trips) or "no reason given"
    code = status.trips[-1].code if status.trips else "preempted"
    return ArmStoppedError(code, f"{ENDED}: {why}", remedy_of(code))


class Moves:
    """`cell.move`: to a pose, to joint angles, by joint angles. SI units.

    Each method waits for arrival and returns the robot state, as `Move.wait`; `begin` only requests
    the move and returns the `Move` to wait for.
    """

    def __init__(self, session: ClientSession) -> None:
        """Start without a move."""
        self._session = session

    def to(
        self,
        position_m: Vec3,
        orientation_xyzw: Quaternion | None = None,
        *,
        speed_m_s: float | None = None,
        timeout_s: float = LONGEST_MOVE_S,
    ) -> RobotState:
        """Move the flange to a pose in base; without an orientation it keeps its own."""
        turned = orientation_xyzw or self._session.feed(topics.ROBOT_STATE)().orientation_xyzw
        pose = PoseRecord(position_m=position_m, orientation_xyzw=turned)
        return self._move(MoveRequest(kind="pose", pose=pose, speed_m_s=speed_m_s), timeout_s)

    def joints(
        self,
        joint_rad: Joints,
        *,
        speed_m_s: float | None = None,
        timeout_s: float = LONGEST_MOVE_S,
    ) -> RobotState:
        """Move the joints to angles [rad]."""
        request = MoveRequest(kind="joints", joint_rad=joint_rad, speed_m_s=speed_m_s)
        return self._move(request, timeout_s)

    def by(
        self,
        joint_rad: Joints,
        *,
        speed_m_s: float | None = None,
        timeout_s: float = LONGEST_MOVE_S,
    ) -> RobotState:
        """Move the joints by angles [rad] from where they are."""
        request = MoveRequest(kind="by", joint_rad=joint_rad, speed_m_s=speed_m_s)
        return self._move(request, timeout_s)

    def jog(
        self,
        shift_m: Vec3 = ZERO3,
        turn_rad: Vec3 = ZERO3,
        *,
        axes: Literal["base", "tool"] = "base",
        speed_m_s: float | None = None,
        timeout_s: float = LONGEST_MOVE_S,
    ) -> RobotState:
        """Shift the tool and turn it about the TCP, along axes of the base or of the tool.

        Args:
            shift_m: Along x, y, z [m].
            turn_rad: Rotation vector about x, y, z [rad].
            axes: Frame of these axes.
            speed_m_s: Speed [m/s]; default: that of `cell.speed`.
            timeout_s: Longest duration [s].
        """
        pose = self.jogged(shift_m, turn_rad, axes=axes)
        return self._move(MoveRequest(kind="pose", pose=pose, speed_m_s=speed_m_s), timeout_s)

    def retract(
        self,
        travel_m: float = RETRACT_M,
        *,
        speed_m_s: float = RETRACT_M_S,
        timeout_s: float = LONGEST_MOVE_S,
    ) -> RobotState:
        """Leave a contact: move straight back along the tool's axis, away from the surface."""
        return self.jog(
            (0.0, 0.0, -travel_m), axes="tool", speed_m_s=speed_m_s, timeout_s=timeout_s
        )

    def jogged(
        self, shift_m: Vec3 = ZERO3, turn_rad: Vec3 = ZERO3, *, axes: Literal["base", "tool"]
    ) -> PoseRecord:
        """Return the flange pose that a jog would reach from the present pose."""
        state = self._session.feed(topics.ROBOT_STATE)()
        tool = self._session.info.T_flange_tcp
        flange = PoseRecord(position_m=state.position_m, orientation_xyzw=state.orientation_xyzw)
        return turning.jogged(flange, tool, shift_m, turn_rad, in_tool_axes=axes == "tool")

    def begin(self, request: MoveRequest) -> Move:
        """Request a move and return immediately. Raises RefusedError, LostError."""
        self._session.feed(topics.ROBOT_STATE).reading()  # subscribe before the move begins
        self._session.feed(topics.ARBITER_STATUS).reading()
        reply = self._session.ask(topics.MOVE, request)
        if reply.value is None:
            raise LostError(f"{topics.MOVE.key}: the reply names no goal")
        return Move(self._session, int(reply.value))

    def _move(self, request: MoveRequest, timeout_s: float) -> RobotState:
        commander = self._session.commander
        return self.begin(request.replaced(commander=commander)).wait(timeout_s)

"""Motion client of the wizard: arm for jog, move the joints, wait, hold."""

from collections.abc import Callable

import numpy as np

from common.motion.convert import joints
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.errors import BusError, RefusedError
from forcemesh.messages import ArbiterStatus, RobotState
from forcemesh.requests import ArmRequest, Empty, HoldRequest, MoveRequest, Reply
from identification.errors import (
    CalibrationError,
    NotBegunError,
    PoseRefusedError,
    StoppedError,
)

POLL_S = 0.01
DRIVE_STATE_WITHIN_S = 2.0
REST_WITHIN_S = 2.0
READY_WITHIN_S = 5.0  # the preflight needs a second of good inputs and rest
HOLD_REASON_WITHIN_S = 0.3  # time for the arbiter to report why a goal has ended
GOAL_MISSING_S = 0.5  # time without this goal in the arbiter's status before it counts as ended
SLOWEST = 4.0  # timeout of a move: multiple of the expected duration, plus SLOWEST_S
SLOWEST_S = 15.0
TRANSIENT_REFUSALS = ("not_ready", "moving", "wait", "busy")  # transient refusals
POSE_REFUSALS = ("joint", "workspace", "tether", "goal_refused")  # refusals of this pose only

Watch = Callable[[str], None]


class Drive:
    """Motion of one arm by joint goals."""

    def __init__(self, bus: Bus, speed_m_s: float) -> None:
        """Subscribe; nothing moves before `arm`."""
        self._bus, self._clock = bus, bus.clock
        self._speed_m_s = speed_m_s
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._arbiter = bus.reader(topics.ARBITER_STATUS)
        self._armed_by_us = False

    def state(self) -> RobotState:
        """Return the state of the arm. Raises CalibrationError when none is received."""
        give_up_ns = self._clock.now_ns() + round(DRIVE_STATE_WITHIN_S * NS_PER_S)
        while True:
            reading = self._robot.read(self._clock.now_ns())
            if reading.fresh is not None:
                return reading.fresh
            if self._clock.now_ns() > give_up_ns:
                raise CalibrationError(f"no robot state: {reading.fault}")
            self._clock.sleep_s(POLL_S)

    def at_rest(self) -> RobotState:
        """Return the state of the arm at rest. Raises CalibrationError when it keeps moving."""
        give_up_ns = self._clock.now_ns() + round(REST_WITHIN_S * NS_PER_S)
        while (state := self.state()).status.moving:
            if self._clock.now_ns() > give_up_ns:
                raise CalibrationError("the arm is moving: wait until it is at rest")
            self._clock.sleep_s(POLL_S)
        return state

    def joints(self) -> Array:
        """Return the joint angles [rad]. Shape (6,)."""
        return np.array(self.state().joint_rad)

    def refuse_unless_free(self) -> None:
        """Raise NotBegunError when another commander moves the arm, or when it is stopped."""
        give_up_ns = self._clock.now_ns() + round(DRIVE_STATE_WITHIN_S * NS_PER_S)
        while (reading := self._arbiter.read(self._clock.now_ns())).fresh is None:
            if self._clock.now_ns() > give_up_ns:
                raise CalibrationError(f"no arbiter status: {reading.fault}")
            self._clock.sleep_s(POLL_S)
        if reading.fresh.state in {"ACTIVE", "SETTLING"}:
            text = f"the {reading.fresh.commander} commands the arm: stop that first"
            raise NotBegunError("busy", text)
        if reading.fresh.state not in {"IDLE", "ARMED"}:
            text = f"{_stop_reason(reading.fresh)}; the wizard starts from IDLE or ARMED"
            raise NotBegunError("held", text)

    def arm(self) -> str:
        """Arm for moves only; return the text of the reply.

        Raises RefusedError when refused, NotBegunError when the arm is not free.
        """
        self.refuse_unless_free()
        reply = self._ask_until(lambda: self._bus.ask(topics.ARM, ArmRequest(purpose="jog")))
        self._armed_by_us = reply.code != "already"
        return reply.text

    def hold(self, reason: str) -> str:
        """Request a hold; return the text of the reply, or the error."""
        try:
            return self._bus.ask(topics.HOLD, HoldRequest(reason=reason[:400])).text
        except BusError as error:
            return f"no reply to the hold request: {error}"

    def release(self) -> None:
        """Disarm the arm when this calibration has armed it."""
        if self._armed_by_us:
            self.hold("the calibration has ended")
            self._bus.ask(topics.CLEAR, Empty())

    def move_joints(self, q: Array, length_m: float, watch: Watch) -> None:
        """Move the joints to angles [rad], shape (6,), and wait until they are reached.

        Raises PoseRefusedError when only this goal is not possible, StoppedError when the arm was
        stopped, RefusedError when no motion is allowed.
        """
        request = MoveRequest(kind="joints", joint_rad=joints(q), speed_m_s=self._speed_m_s)
        reply = self._ask_until(lambda: self._bus.ask(topics.MOVE, request), POSE_REFUSALS)
        if not reply.accepted:
            raise PoseRefusedError(reply.text)
        expected_s = length_m / self._speed_m_s
        self._follow(int(reply.value or 0), SLOWEST * expected_s + SLOWEST_S, watch)

    def check(self) -> None:
        """Raise StoppedError with the arbiter's reason when the arm was stopped."""
        reading = self._arbiter.read(self._clock.now_ns())
        if reading.fresh is not None and not reading.fresh.operational:
            raise StoppedError(_stop_reason(reading.fresh))
        if reading.silent and reading.message is not None:
            raise CalibrationError(f"no arbiter status: {reading.fault}")

    def _ask_until(self, ask: Callable[[], Reply], final: tuple[str, ...] = ()) -> Reply:
        """Repeat the request while its refusal is transient."""
        give_up_ns = self._clock.now_ns() + round(READY_WITHIN_S * NS_PER_S)
        while True:
            reply = ask()
            if reply.accepted or reply.code in final:
                return reply
            if reply.code not in TRANSIENT_REFUSALS or self._clock.now_ns() > give_up_ns:
                raise RefusedError(reply.code, reply.text)
            self._clock.sleep_s(10.0 * POLL_S)

    def _follow(self, goal_id: int, within_s: float, watch: Watch) -> None:
        """Return when the goal is reached."""
        started_ns = last_active_ns = self._clock.now_ns()
        while True:
            self._clock.sleep_s(POLL_S)
            watch("moving")
            now_ns = self._clock.now_ns()
            goal = self.state().goal
            if goal.id == goal_id and goal.state == "done":
                return
            if goal.id == goal_id and goal.state == "refused":
                self._raise_end_reason(goal.reason)
            status = self._arbiter.read(now_ns).fresh
            if status is None or status.goal_id == goal_id:
                last_active_ns = now_ns
            elif now_ns - last_active_ns > GOAL_MISSING_S * NS_PER_S:
                self._raise_end_reason("; ".join(trip.text for trip in status.trips))
            self.check()
            if now_ns - started_ns > within_s * NS_PER_S:
                raise CalibrationError(f"a pose was not reached within {within_s:.0f} s")

    def _raise_end_reason(self, reason: str) -> None:
        """Raise StoppedError or PoseRefusedError for a goal that ended before its pose."""
        end_ns = self._clock.now_ns() + round(HOLD_REASON_WITHIN_S * NS_PER_S)
        while self._clock.now_ns() < end_ns:
            self.check()
            self._clock.sleep_s(POLL_S)
        raise PoseRefusedError(reason or "no reason given")


def _stop_reason(status: ArbiterStatus) -> str:
    causes = "; ".join(trip.text for trip in status.trips) or "no cause given"
    clears = f"; {status.clears}" if status.clears else ""
    return f"the arbiter is {status.state}: {causes}{clears}"

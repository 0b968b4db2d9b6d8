"""Moves the arm as any client does: arm for jog, move the joints, wait, hold. Nothing else."""

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
HEARD_WITHIN_S = 2.0
REST_WITHIN_S = 2.0
READY_WITHIN_S = 5.0  # the preflight wants a second of good inputs and rest
AFTERWARDS_S = 0.3  # so long the arbiter may take to say why a goal has ended
TAKEN_S = 0.5  # so long it must have named another goal, or none, before it is believed
SLOWEST = 4.0  # times the expected duration, and the seconds more, that a way may take
SLOWEST_S = 15.0
PASSING = ("not_ready", "moving", "wait", "busy")  # refusals that time mends
OF_THE_POSE = ("joint", "workspace", "tether", "goal_refused")  # refusals that another pose mends

Watch = Callable[[str], None]


class Drive:
    """One arm, moved by goals of its joints."""

    def __init__(self, bus: Bus, speed_m_s: float) -> None:
        """Subscribe; nothing moves before `arm`."""
        self._bus, self._clock = bus, bus.clock
        self._speed_m_s = speed_m_s
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._arbiter = bus.reader(topics.ARBITER_STATUS)
        self._armed_by_us = False

    def state(self) -> RobotState:
        """Return where the arm is. Raises CalibrationError when it is not heard."""
        give_up_ns = self._clock.now_ns() + round(HEARD_WITHIN_S * NS_PER_S)
        while True:
            reading = self._robot.read(self._clock.now_ns())
            if reading.fresh is not None:
                return reading.fresh
            if self._clock.now_ns() > give_up_ns:
                raise CalibrationError(f"lost sight of the arm: {reading.fault}")
            self._clock.sleep_s(POLL_S)

    def at_rest(self) -> RobotState:
        """Return where the arm is, at rest. Raises CalibrationError when it goes on moving."""
        give_up_ns = self._clock.now_ns() + round(REST_WITHIN_S * NS_PER_S)
        while (state := self.state()).status.moving:
            if self._clock.now_ns() > give_up_ns:
                raise CalibrationError("the arm is moving: let it rest first")
            self._clock.sleep_s(POLL_S)
        return state

    def joints(self) -> Array:
        """Return the joint angles [rad]. Shape (6,)."""
        return np.array(self.state().joint_rad)

    def refuse_unless_free(self) -> None:
        """Raise NotBegunError when somebody else has the arm, or has stopped it: they know why."""
        give_up_ns = self._clock.now_ns() + round(HEARD_WITHIN_S * NS_PER_S)
        while (reading := self._arbiter.read(self._clock.now_ns())).fresh is None:
            if self._clock.now_ns() > give_up_ns:
                raise CalibrationError(f"the arbiter is not heard: {reading.fault}")
            self._clock.sleep_s(POLL_S)
        if reading.fresh.state in {"ACTIVE", "SETTLING"}:
            text = f"the {reading.fresh.commander} commands the arm: stop that first"
            raise NotBegunError("busy", text)
        if reading.fresh.state not in {"IDLE", "ARMED"}:
            text = f"{_why(reading.fresh)}; the wizard begins from IDLE or ARMED"
            raise NotBegunError("held", text)

    def arm(self) -> str:
        """Arm for moves alone, and say how that was answered.

        Raises RefusedError when it was refused, NotBegunError when the arm is not free.
        """
        self.refuse_unless_free()
        reply = self._ask_until(lambda: self._bus.ask(topics.ARM, ArmRequest(purpose="jog")))
        self._armed_by_us = reply.code != "already"
        return reply.text

    def hold(self, reason: str) -> str:
        """Ask for a hold, whatever happens; say what came of it."""
        try:
            return self._bus.ask(topics.HOLD, HoldRequest(reason=reason[:400])).text
        except BusError as error:
            return f"hold was not answered: {error}"

    def release(self) -> None:
        """Leave the arm as it was found: not armed, when it was us who armed it."""
        if self._armed_by_us:
            self.hold("the calibration is done")
            self._bus.ask(topics.CLEAR, Empty())

    def go(self, q: Array, length_m: float, watch: Watch) -> None:
        """Move the joints to angles [rad], shape (6,), and wait until they are there.

        Raises PoseRefusedError when this goal alone is not possible, StoppedError when the arm was
        stopped, RefusedError when nobody may move it.
        """
        request = MoveRequest(kind="joints", joint_rad=joints(q), speed_m_s=self._speed_m_s)
        reply = self._ask_until(lambda: self._bus.ask(topics.MOVE, request), OF_THE_POSE)
        if not reply.accepted:
            raise PoseRefusedError(reply.text)
        expected_s = length_m / self._speed_m_s
        self._follow(int(reply.value or 0), SLOWEST * expected_s + SLOWEST_S, watch)

    def check(self) -> None:
        """Raise StoppedError, in the arbiter's words, when the arm was stopped."""
        reading = self._arbiter.read(self._clock.now_ns())
        if reading.fresh is not None and not reading.fresh.goes_on:
            raise StoppedError(_why(reading.fresh))
        if reading.silent and reading.message is not None:
            raise CalibrationError(f"the arbiter is not heard: {reading.fault}")

    def _ask_until(self, ask: Callable[[], Reply], final: tuple[str, ...] = ()) -> Reply:
        """Ask again while the refusal is one that time mends."""
        give_up_ns = self._clock.now_ns() + round(READY_WITHIN_S * NS_PER_S)
        while True:
            reply = ask()
            if reply.accepted or reply.code in final:
                return reply
            if reply.code not in PASSING or self._clock.now_ns() > give_up_ns:
                raise RefusedError(reply.code, reply.text)
            self._clock.sleep_s(10.0 * POLL_S)

    def _follow(self, goal_id: int, within_s: float, watch: Watch) -> None:
        """Return when the goal is done."""
        started_ns = mine_ns = self._clock.now_ns()
        while True:
            self._clock.sleep_s(POLL_S)
            watch("moving")
            now_ns = self._clock.now_ns()
            goal = self.state().goal
            if goal.id == goal_id and goal.state == "done":
                return
            if goal.id == goal_id and goal.state == "refused":
                self._judge_end(goal.reason)
            status = self._arbiter.read(now_ns).fresh
            if status is None or status.goal_id == goal_id:
                mine_ns = now_ns
            elif now_ns - mine_ns > TAKEN_S * NS_PER_S:
                self._judge_end("; ".join(trip.text for trip in status.trips))
            self.check()
            if now_ns - started_ns > within_s * NS_PER_S:
                raise CalibrationError(f"a pose was not reached within {within_s:.0f} s")

    def _judge_end(self, reason: str) -> None:
        """Raise what the end of a goal short of its pose means: a stopped arm, or a bad pose."""
        end_ns = self._clock.now_ns() + round(AFTERWARDS_S * NS_PER_S)
        while self._clock.now_ns() < end_ns:
            self.check()
            self._clock.sleep_s(POLL_S)
        raise PoseRefusedError(reason or "no reason given")


def _why(status: ArbiterStatus) -> str:
    causes = "; ".join(trip.text for trip in status.trips) or "no cause given"
    clears = f"; {status.clears}" if status.clears else ""
    return f"the arbiter is {status.state}: {causes}{clears}"

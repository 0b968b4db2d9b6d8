"""Scripted client: brings the arm into a phase of the job and selects the injection time."""

import random
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from common.motion.convert import pose_of, record_of
from forcemesh import topics
from forcemesh.errors import ForcemeshError
from forcemesh.messages import (
    ArmPurpose,
    Host,
)
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest, MoveRequest, Reply
from tests.chaos.cases import Phase
from tests.chaos.recorder_client import RecorderClient

READY_WITHIN_S = 30.0
ASK_EVERY_S = 0.05
IN_CONTACT = "payload"  # fault code of a residual force
MOVED_WITHIN_S = 15.0
APPROACH_M_S = 0.1
PRESS_N = 35.0
RELEASE_FROM_M = -0.0175  # flange height relative to home; contact begins at -5 mm
NEAR_M = -0.003
FAR_M = 0.08


class NotMovingError(Exception):
    """Error: the arm did not reach the phase; the trial does not count."""


class ScriptedJob:
    """Client that runs the job on the cell."""

    def __init__(self, recorder: RecorderClient, *, release_host: Host) -> None:
        """Store the first pose of the arm as home."""
        self._recorder, self._host = recorder, release_host
        if not recorder.until(lambda: recorder.robot() is not None, READY_WITHIN_S):
            raise NotMovingError("no robot state received")
        robot = recorder.robot()
        if robot is None:
            raise NotMovingError("the robot state has expired")
        self._T_base_home = pose_of(robot)

    def arm(self) -> None:
        """Clear latched faults and arm as soon as permitted; move out of contact first.

        Raises NotMovingError after the time-out.
        """
        reply = self._arm_for("all")
        if reply is not None and reply.code == IN_CONTACT:
            self._arm_for("jog")
            self._go(NEAR_M, speed_m_s=0.1)
            self.hold()
            reply = self._arm_for("all")
        if reply is None or not reply.accepted:
            raise NotMovingError(f"it could not be armed: {reply.text if reply else 'silent'}")

    def _arm_for(self, purpose: ArmPurpose) -> Reply | None:
        """Repeat the request until it is armed, or contact prevents it; return the reply."""
        reply: Reply | None = None

        def decided() -> bool:
            nonlocal reply
            self._recorder.during(ASK_EVERY_S)
            arbiter = self._recorder.arbiter()
            if arbiter is None or arbiter.state == "BOOT":
                return False
            try:
                if arbiter.state == "FAULT":
                    reply = self._recorder.bus.ask(topics.CLEAR, Empty())
                    if not reply.accepted:
                        return False
                reply = self._recorder.bus.ask(topics.ARM, ArmRequest(purpose=purpose))
            except ForcemeshError:
                return False
            return reply.accepted or reply.code == IN_CONTACT

        self._recorder.until(decided, READY_WITHIN_S)
        return reply

    def begin(self, phase: Phase, numbers: random.Random) -> None:
        """Bring the arm into a phase; return at the injection time.

        Raises NotMovingError if the arm does not reach the phase.
        """
        if phase == "approach":
            self._go(FAR_M, speed_m_s=0.2)
            share = numbers.uniform(0.2, 0.7)
            self._request_move(0.0, speed_m_s=APPROACH_M_S)
            self._until(lambda: self._height_m() < FAR_M * (1.0 - share), "approach")
        elif phase == "press":
            self._go(NEAR_M, speed_m_s=0.1)
            threshold_N = numbers.uniform(4.0, 15.0)
            self._feedback(PRESS_N, "pc")
            self._until(lambda: self._force_N() > threshold_N, "press")
        else:
            self._go(NEAR_M, speed_m_s=0.1)
            self._go(RELEASE_FROM_M, speed_m_s=0.05)
            threshold_N = numbers.uniform(12.0, 20.0)
            self._feedback(0.0, self._host)
            self._until(lambda: self._force_N() < threshold_N, "release")

    def hold(self) -> None:
        """Request a hold; a missing reply is ignored."""
        try:
            self._recorder.bus.ask(topics.HOLD, HoldRequest(reason="the trial is over"), 1.0)
        except ForcemeshError:
            return

    def provoke(self) -> list[str]:
        """Request motion without arming; return the requests wrongly accepted."""
        start = self._request(0.0, 0.05)
        try:
            move = self._recorder.bus.ask(topics.MOVE, start, 1.0)
            force = self._recorder.bus.ask(
                topics.FORCE_START, ForceStartRequest(mode="position"), 1.0
            )
        except ForcemeshError:
            return []  # no process is running that could accept
        replies = {"move": move, "force feedback": force}
        return [name for name, reply in replies.items() if reply.accepted]

    # --- internal ---------------------------------------------------------------------------------

    def _go(self, height_m: float, *, speed_m_s: float) -> None:
        goal = self._request_move(height_m, speed_m_s=speed_m_s)
        self._until(lambda: self._is_done(goal), f"the move to {height_m * 1e3:.0f} mm")

    def _is_done(self, goal: int) -> bool:
        robot, arbiter = self._recorder.robot(), self._recorder.arbiter()
        if robot is None or arbiter is None or robot.goal.id != goal:
            return False
        return robot.goal.state == "done" and arbiter.commander == "none"

    def _request(self, height_m: float, speed_m_s: float) -> MoveRequest:
        T = pin.SE3(self._T_base_home)
        T.translation = np.asarray(T.translation) + np.array([0.0, 0.0, height_m])
        return MoveRequest(kind="pose", pose=record_of(T), speed_m_s=speed_m_s)

    def _request_move(self, height_m: float, *, speed_m_s: float) -> int:
        reply = self._reply(topics.MOVE, self._request(height_m, speed_m_s))
        return round(reply.value or 0.0)

    def _feedback(self, setpoint_N: float, host: Host) -> None:
        start = ForceStartRequest(mode="position", host=host, setpoint_N=setpoint_N)
        self._reply(topics.FORCE_START, start)

    def _reply(self, request: topics.Request[topics.Q], message: topics.Q) -> Reply:
        try:
            reply = self._recorder.bus.ask(request, message)
        except ForcemeshError as error:
            raise NotMovingError(str(error)) from error
        if not reply.accepted:
            raise NotMovingError(f"{request.key} was refused ({reply.code}): {reply.text}")
        return reply

    def _until(self, what: Callable[[], bool], doing: str) -> None:
        """Wait for a condition; a stop of the arm ends the wait at once."""
        stopped = ""

        def there() -> bool:
            nonlocal stopped
            arbiter = self._recorder.arbiter()
            if arbiter is not None and not arbiter.operational:
                stopped = "; ".join(trip.text for trip in arbiter.trips) or arbiter.state
            return bool(stopped) or what()

        if not self._recorder.until(there, MOVED_WITHIN_S) or stopped:
            raise NotMovingError(f"{doing}: {stopped or 'it did not come in time'}")

    def _height_m(self) -> float:
        robot = self._recorder.robot()
        home_m = float(self._T_base_home.translation[2])
        return float("inf") if robot is None else robot.position_m[2] - home_m

    def _force_N(self) -> float:
        force_N = self._recorder.force_N()
        return float("nan") if force_N is None else force_N

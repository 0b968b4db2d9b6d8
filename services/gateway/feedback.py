"""Force feedback in the controller: start, samples, changes and end. No socket."""

from collections.abc import Callable
from dataclasses import dataclass
from math import dist

import numpy as np
import pinocchio as pin

from common.motion.frames import plus
from common.motion.limits import LEVER_M, share_at
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import Feedback, Trip, Vec3, WrenchAtTcp
from services.gateway.dialogue import Dialogue
from services.gateway.setpoint_shaper import SetpointShaper

FEEDBACK_STARTS_WITHIN_S = 1.0
CENTRE_STEP_M = 3e-3  # travel of the contact point below which no command is sent


@dataclass(slots=True)
class RunningFeedback:
    """Force feedback requested from the controller."""

    feedback: Feedback
    since_ns: int
    lever_m: Vec3  # sent to the controller last


def slow_setpoint(feedback: Feedback, wrench: WrenchAtTcp) -> tuple[Vec3, Vec3]:
    """Return the set point [N, N m], nearer to the reading where it would be too fast."""
    gains, fastest = feedback.gains, feedback.speed_m_s
    force, torque = feedback.setpoint_force_N, feedback.setpoint_torque_Nm
    if fastest is None:
        return force, torque
    parts = (
        (wrench.force_N, force, gains.force_i_m_per_Ns, fastest),
        (wrench.torque_Nm, torque, gains.torque_i_rad_per_Nms, fastest / LEVER_M),
    )
    nearer = []
    for reading, setpoint, gain, speed in parts:
        share = share_at(speed, plus(reading, setpoint, -1.0), gain)
        nearer.append(plus(reading, plus(setpoint, reading, -1.0), share))
    return nearer[0], nearer[1]


class ControllerFeedback:
    """Force feedback that the controller was asked to run."""

    def __init__(
        self,
        dialogue: Dialogue,
        send: Callable[[bytes, int], None],
        shaper: SetpointShaper,
        T_flange_tcp: pin.SE3,
    ) -> None:
        """Start without; `send` takes bytes and the time [ns]."""
        self._dialogue, self._send, self._shaper = dialogue, send, shaper
        self._T_flange_tcp = T_flange_tcp
        self._running: RunningFeedback | None = None
        self._last_wrench: tuple[int, int] | None = None

    @property
    def active(self) -> bool:
        """Whether feedback is requested, or the controller runs it."""
        return self._running is not None or self._dialogue.feedback_active

    def run(
        self, feedback: Feedback, wrench: WrenchAtTcp, sample: tuple[int, int], now_ns: int
    ) -> Trip | None:
        """Start, feed or change force feedback; return why it cannot run."""
        self._shaper.end()
        running = self._running
        if running is None:
            self._start(feedback, now_ns)
        elif not self._dialogue.feedback_active:
            return tripped("feedback", "the controller has ended force feedback by itself")
        elif feedback.mode != running.feedback.mode:
            self.end(now_ns)
        else:
            if feedback.gains != running.feedback.gains:
                self._dialogue.offer_gains(feedback.gains)
            running.lever_m = self._move_centre(running, feedback)
            running.feedback = feedback
            return self._feed_back(feedback, wrench, sample, now_ns - running.since_ns)
        return None

    def end(self, now_ns: int) -> None:
        """Stop feedback that was started."""
        if self._running is not None:
            self._running = None
            self._send(self._dialogue.stop_feedback(now_ns), now_ns)

    def held(self) -> None:
        """Register a hold, which has ended it."""
        self._running = None

    def _start(self, feedback: Feedback, now_ns: int) -> None:
        if not self._dialogue.may_begin:
            return
        self._send(self._dialogue.set_centre(self._centre(feedback), now_ns), now_ns)
        data = self._dialogue.start_feedback(
            feedback.mode, feedback.gains, permitted=True, now_ns=now_ns
        )
        self._send(data, now_ns)
        self._shaper.moved_otherwise()
        self._running = RunningFeedback(feedback, now_ns, feedback.lever_m)

    def _move_centre(self, running: RunningFeedback, feedback: Feedback) -> Vec3:
        """Offer the contact point as centre of rotation when it has moved; return the lever."""
        travel_m = dist(feedback.lever_m, running.lever_m)
        if travel_m < CENTRE_STEP_M:
            return running.lever_m
        self._dialogue.offer_centre(self._centre(feedback))
        return feedback.lever_m

    def _centre(self, feedback: Feedback) -> pin.SE3:
        """Return the centre of rotation as a frame in the flange's, with the TCP's axes."""
        T = self._T_flange_tcp
        return pin.SE3(T.rotation, T.translation + np.array(feedback.lever_m))

    def _feed_back(
        self, feedback: Feedback, wrench: WrenchAtTcp, sample: tuple[int, int], since_ns: int
    ) -> Trip | None:
        """Offer each sample once: the controller integrates every wrench it receives."""
        if not self._dialogue.feedback_reported:
            if since_ns > FEEDBACK_STARTS_WITHIN_S * NS_PER_S:
                return tripped("feedback", "the controller did not start force feedback")
        elif sample != self._last_wrench:
            self._last_wrench = sample
            self._dialogue.offer_wrench(
                wrench.force_N, wrench.torque_Nm, *slow_setpoint(feedback, wrench)
            )
        return None

"""Contact events: states of the contact of the tool, with times, place and peak force. Pure.

The states and their changes are one table. What happened follows from each sample of wrench and
pose. While the law presses, its own contact state decides whether the tool touches; without force
feedback the length of the force does, above what a tool in acceleration shows:

    touch   |F| > max(touch_N, idle_max_N) + inertia_kg * accel_m_s2      ends at half of the first

An impact ends when the force has passed its first peak, or after IMPACT_S. The tool slides when the
contact point moves across the normal, at a speed that is the mean over a window of poses. Without a
valid input, or with a wrench that is not calibrated, the state is unknown from the last sample on.
"""

from collections import deque
from dataclasses import dataclass
from math import hypot
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of, vec3
from common.motion.frames import cross, dot, plus, rotated, scaled
from control.law import (
    LONGEST_CONTACT_LEVER_M,
    RELEASE_FRACTION,
    Contact,
    limit_norm,
)
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.messages import (
    TOUCHING,
    ZERO3,
    ContactEvent,
    ContactState,
    RobotState,
    Vec3,
    WrenchAtTcp,
)
from forcemesh.reader import Reading
from services.regulator.session import ForceSession

IMPACT_S = 0.2  # longest impact: a force that only rises has no peak
PEAK_SHARE = 0.1  # of the peak, by which the force has fallen when it is passed
LOST_S = 0.3  # until a lost contact is free motion or another approach; bounces are shorter
SPEED_WINDOW_S = 0.1  # of the speed of the contact point
FEWEST_REPORTS = 3.0  # in the window, on a slow link
SLIDES_M_S, RESTS_M_S = 0.002, 0.001  # rounding of a pose to 0.05 mm is 0.5 mm/s in the window
SLIDE_STEADY_S = 0.05  # a speed is above or below its limit for this time before it counts

Happening = Literal["search", "touch", "settle", "slide", "rest", "release", "clear", "fail"]

TABLE: dict[ContactState, dict[Happening, ContactState]] = {
    "unknown": {"clear": "free", "search": "approach", "touch": "contact"},  # no impact was seen
    "free": {"search": "approach", "touch": "impact", "fail": "unknown"},
    "approach": {"clear": "free", "touch": "impact", "fail": "unknown"},
    "impact": {"settle": "contact", "release": "lost", "fail": "unknown"},
    "contact": {"slide": "sliding", "release": "lost", "fail": "unknown"},
    "sliding": {"rest": "contact", "release": "lost", "fail": "unknown"},
    "lost": {"clear": "free", "search": "approach", "touch": "impact", "fail": "unknown"},
}


@dataclass(frozen=True, slots=True)
class ContactSettings:
    """Limits of the events."""

    touch_N: float  # without force feedback
    release_N: float  # the same
    settle_N: float  # least fall from a peak
    window_ns: float
    period_ns: int  # between two messages without a change
    steps: int  # the same in steps of the regulator

    @classmethod
    def of(cls, cell: CellConfig) -> "ContactSettings":
        """Return the settings of a cell."""
        at_rest_N = max(cell.force.touch_N, cell.force.idle_max_N)
        return cls(
            touch_N=at_rest_N + cell.contact.inertia_kg * cell.limits.accel_m_s2,
            release_N=RELEASE_FRACTION * at_rest_N,
            settle_N=cell.force.deadband_N,
            window_ns=NS_PER_S * max(SPEED_WINDOW_S, FEWEST_REPORTS / cell.rates.robot_hz),
            period_ns=round(NS_PER_S / cell.rate_hz(topics.CONTACT)),
            steps=max(1, round(cell.rates.control_hz / cell.rate_hz(topics.CONTACT))),
        )


@dataclass(frozen=True, slots=True)
class ContactInput:
    """Wrench and measured pose at one time."""

    at_ns: int  # stamp of the wrench
    posed_ns: int  # stamp of the pose, which may come less often
    force_N: Vec3  # of the environment on the tool, base axes
    torque_Nm: Vec3  # about the TCP
    T_base_tcp: pin.SE3
    law: Contact | None = None  # of a law that presses; None: the force decides
    press_axis: Vec3 = ZERO3  # of that law, base axes


def pressing(session: ForceSession | None, T_base_tcp: pin.SE3) -> tuple[Contact | None, Vec3]:
    """Return contact state and press axis (base axes) of a law that presses; else None, zero."""
    if session is None or session.failed or session.goal.press_N <= 0.0:
        return None, ZERO3
    if session.motion.error_force_N is None:  # it has not judged a sample yet
        return None, ZERO3
    task = session.goal
    R_base_task = task.R_base_task(T_base_tcp.rotation.tolist())
    return session.motion.contact, rotated(R_base_task, task.press_axis)


class ContactTracker:
    """Contact state of the tool, advanced by each sample."""

    def __init__(self, cell: CellConfig, last: ContactEvent | None = None) -> None:
        """Begin in an unknown state, or continue after a message, for a replay."""
        self.event = last or ContactEvent(valid=False, code="missing", reason="no sample yet")
        self._settings = ContactSettings.of(cell)
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._at_ns = self._put_ns = self.event.since_ns + round(self.event.duration_s * NS_PER_S)
        self._poses: deque[tuple[int, pin.SE3]] = deque()
        self._force_N, self._normal, self._speed_m_s = 0.0, ZERO3, ZERO3
        self._steady_ns: int | None = None  # since when the speed is beyond its limit
        self._silent_steps = 0

    def next(
        self,
        wrench: Reading[WrenchAtTcp],
        robot: Reading[RobotState],
        session: ForceSession | None,
    ) -> ContactEvent | None:
        """Take the inputs of a step; return the message that is due, if one is."""
        fresh, arm, header = wrench.fresh, robot.fresh, wrench.header
        if fresh is None or arm is None or header is None or robot.header is None:
            worse: Reading[Any] = wrench if wrench.fault else robot
            return self._silent(worse.code, worse.fault)
        if not fresh.calibrated:
            return self._silent(
                "payload", fresh.calibration_fault or "the wrench is not calibrated"
            )
        if header.stamp_ns == self._at_ns:
            return None
        T = pose_of(arm) * self._T_flange_tcp
        self._silent_steps, number = 0, self.event.number
        law, axis = pressing(session, T)
        sample = ContactInput(
            header.stamp_ns, robot.header.stamp_ns, fresh.force_N, fresh.torque_Nm, T, law, axis
        )
        self.observe(sample)
        is_due = self._at_ns - self._put_ns >= self._settings.period_ns
        if self.event.number == number and not is_due:
            return None
        self._put_ns = self._at_ns
        return self.event

    def observe(self, sample: ContactInput) -> None:
        """Advance by one sample."""
        if sample.at_ns < self._at_ns:  # another clock: the times do not belong together
            self.fail("invalid", "the clock of the wrench has changed")
            self.event, self._at_ns = self.event.replaced(since_ns=sample.at_ns), sample.at_ns
        since_s = (sample.at_ns - self._at_ns) / NS_PER_S
        self._at_ns, self._force_N = sample.at_ns, hypot(*sample.force_N)
        self._take_normal(sample)
        self._take_pose(sample)
        event, slid_m = self.event, self.event.slid_m
        if event.state == "sliding":
            slid_m += self._across_m_s() * since_s
        happening = self._happening(sample)
        after = None if happening is None else TABLE[event.state].get(happening)
        if after is not None:
            self._change(after, vec3(sample.T_base_tcp.translation), slid_m)
            return
        peak_N = max(event.peak_N, self._force_N) if event.state in TOUCHING else 0.0
        self.event = event.replaced(duration_s=self._duration_s(), peak_N=peak_N, slid_m=slid_m)

    def fail(self, code: str, reason: str) -> None:
        """End the state at the last sample: what follows is not seen."""
        if self.event.state != "unknown":
            _, T_base_tcp = self._poses[-1] if self._poses else (0, pin.SE3.Identity())
            self._change("unknown", vec3(T_base_tcp.translation), self.event.slid_m)
            self._poses.clear()
        self.event = self.event.replaced(valid=False, code=code, reason=reason)

    def _silent(self, code: str, reason: str) -> ContactEvent | None:
        """Fail; return the message in the first step without inputs, then at the status rate."""
        self.fail(code, reason)
        self._silent_steps += 1
        return self.event if (self._silent_steps - 1) % self._settings.steps == 0 else None

    def _happening(self, sample: ContactInput) -> Happening | None:
        """Return what happened, as far as it matters in the present state; None: nothing."""
        state, touches = self.event.state, self._touches(sample)
        if state not in TOUCHING:
            if touches:
                return "touch"
            if state == "lost" and self._duration_s() < LOST_S:
                return None
            return "search" if sample.law == "approach" else "clear"
        if not touches:
            return "release"
        if state == "impact":
            peak_N = self.event.peak_N
            fallen_N = peak_N - max(PEAK_SHARE * peak_N, self._settings.settle_N)
            is_over = self._force_N < fallen_N or self._duration_s() >= IMPACT_S
            return "settle" if is_over else None
        return self._slides_or_rests(sample.at_ns)

    def _slides_or_rests(self, at_ns: int) -> Happening | None:
        """Return the change between contact and sliding, once it has lasted."""
        is_sliding = self.event.state == "sliding"
        moves = self._across_m_s() > (RESTS_M_S if is_sliding else SLIDES_M_S)
        if moves == is_sliding:
            self._steady_ns = None
            return None
        self._steady_ns = at_ns if self._steady_ns is None else self._steady_ns
        if at_ns - self._steady_ns < SLIDE_STEADY_S * NS_PER_S:
            return None
        return "slide" if moves else "rest"

    def _touches(self, sample: ContactInput) -> bool:
        if sample.law is not None:
            return sample.law == "contact"
        settings = self._settings
        limit_N = settings.release_N if self.event.state in TOUCHING else settings.touch_N
        return self._force_N > limit_N

    def _take_normal(self, sample: ContactInput) -> None:
        """Update the normal: against the press, or the direction of the force."""
        if sample.law is not None:
            self._normal = scaled(sample.press_axis, -1.0)
        elif self._force_N > self._settings.release_N:
            self._normal = scaled(sample.force_N, 1.0 / self._force_N)
        else:
            self._normal = ZERO3

    def _take_pose(self, sample: ContactInput) -> None:
        """Update the speed of the contact point, if the pose is new."""
        poses, at_ns = self._poses, sample.posed_ns
        if poses and at_ns <= poses[-1][0]:
            return
        poses.append((at_ns, sample.T_base_tcp))
        while len(poses) > 2 and at_ns - poses[1][0] >= self._settings.window_ns:
            poses.popleft()
        first_ns, T_first = poses[0]
        if at_ns == first_ns:
            self._speed_m_s = ZERO3
            return
        lever_m = ZERO3
        if self._force_N > self._settings.release_N:  # a turn about the contact does not slide
            lever_m = scaled(cross(sample.force_N, sample.torque_Nm), self._force_N**-2)
            lever_m = limit_norm(lever_m, LONGEST_CONTACT_LEVER_M)
        p_m = sample.T_base_tcp.translation + np.array(lever_m)
        before_m = T_first.act(sample.T_base_tcp.actInv(p_m))  # the same point of the tool
        self._speed_m_s = scaled(vec3(p_m - before_m), NS_PER_S / (at_ns - first_ns))

    def _across_m_s(self) -> float:
        along_m_s = dot(self._speed_m_s, self._normal)
        return hypot(*plus(self._speed_m_s, self._normal, -along_m_s))

    def _duration_s(self) -> float:
        event = self.event  # the first one has no beginning
        return (self._at_ns - event.since_ns) / NS_PER_S if event.since_ns else 0.0

    def _change(self, state: ContactState, position_m: Vec3, slid_m: float) -> None:
        event, is_impact = self.event, state == "impact"
        toward_m_s = max(0.0, -dot(self._speed_m_s, self._normal))
        self._steady_ns = None
        self.event = ContactEvent(
            number=event.number + 1,
            state=state,
            since_ns=self._at_ns,
            peak_N=self._force_N if state in TOUCHING else 0.0,
            position_m=position_m,
            normal=self._normal,
            before=event.state,
            before_s=self._duration_s(),
            before_peak_N=event.peak_N,
            impact_m_s=toward_m_s if is_impact else event.impact_m_s,
            slid_m=0.0 if is_impact else slid_m,
        )

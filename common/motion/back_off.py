"""Backing off: planned motion that frees an arm above a ceiling or outside the workspace. Pure.

The path is computed from measured values, never from a request: straight along the force on the
tool; outside the workspace straight back in; without a usable force, a short distance back along
the tool's axis. Arbiter and robot each compute and check it independently, with these rules.
The ceilings are a ratchet: they fall with the load and never rise.
"""

from dataclasses import dataclass, replace
from math import degrees, hypot, inf, radians
from typing import Literal

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, apart, is_finite_pose
from common.motion.limits import Limits, check_workspace, real_speed_m_s
from forcemesh.faults import tripped
from forcemesh.messages import Speed, Trip, WrenchAtTcp

SPEED_M_S = 0.005
LONGEST_BACK_OFF_M = 0.020
BLIND_M = 0.005  # path without a usable force
RISE_N, RISE_Nm = 3.0, 0.3  # above the lowest load so far
ENDS_BELOW = 0.5  # of the ceilings
LEAST_BACK_OFF_FORCE_N = 5.0  # the direction of a smaller force is unreliable
MOST_FORWARD = 0.5  # cosine: a force pointing more out of the tool has a wrong sign or bias
OUTWARD_SHARE = 0.3  # largest share of a path that may be removed
INSIDE_M = 1e-3  # distance inside the workspace at which the return path ends
SHORTEST_M = 1e-3
LONGEST_BACK_OFF_S = 10.0
TURN_RAD = radians(1.0)  # measured rotation of the flange
# A force that does not fall over half the path is no contact force: a lost bias, or a hooked tool.
MUST_FALL_AFTER_M, MUST_FALL_N = 0.5 * LONGEST_BACK_OFF_M, 3.0
LATE_M, FAST = 2e-3, 1.5  # tolerance of the measured travel: rounding, report latency
SAME_DIRECTION = 0.9  # cosine between the paths that two processes compute from their own readings
SAME_PATH_M, SAME_TURN_RAD = 1e-3, radians(0.2)

BackOffKind = Literal["force", "workspace", "blind"]


@dataclass(frozen=True, slots=True)
class BackOffPlan:
    """A straight path of the tool without rotation, in base axes."""

    kind: BackOffKind
    travel_m: Array  # shape (3,)

    def goal(self, T_base_flange: pin.SE3) -> pin.SE3:
        """Return the flange pose at the end."""
        return pin.SE3(T_base_flange.rotation, T_base_flange.translation + self.travel_m)

    def __str__(self) -> str:
        """Return a description."""
        texts = {
            "force": "along the measured force",
            "workspace": "straight back into the workspace",
            "blind": "back along the tool's axis, without a force to follow",
        }
        travel_mm, most_mm_s = 1e3 * hypot(*self.travel_m), 1e3 * SPEED_M_S
        return f"{travel_mm:.1f} mm {texts[self.kind]}, at most {most_mm_s:g} mm/s"


def plan(
    limits: Limits,
    T_base_flange: pin.SE3,
    T_flange_tcp: pin.SE3,
    wrench: WrenchAtTcp | None,
    *,
    confirmed: bool,
) -> BackOffPlan | Trip:
    """Return the path, or why there is none.

    Args:
        limits: The cell's own.
        T_base_flange: Flange pose in base.
        T_flange_tcp: Tool frame.
        wrench: Measured wrench; None when unknown.
        confirmed: Whether a person has confirmed a path without a usable force.
    """
    if not is_finite_pose(T_base_flange):
        return tripped("not_finite", "the pose of the flange is not finite")
    T_base_tcp = T_base_flange * T_flange_tcp
    path = _direct_path(limits, T_base_tcp, wrench)
    if isinstance(path, Trip):
        if path.code != "no_direction" or not confirmed:
            return path
        path = BackOffPlan("blind", -BLIND_M * T_base_tcp.rotation[:, 2])
    travel_m = _not_outward(limits, T_base_tcp.translation, path.travel_m)
    return _inside_part(
        relaxed_limits(limits, T_base_tcp), T_base_tcp, replace(path, travel_m=travel_m)
    )


def _direct_path(
    limits: Limits, T_base_tcp: pin.SE3, wrench: WrenchAtTcp | None
) -> BackOffPlan | Trip:
    if wrench is None or not wrench.calibrated:
        cause = (
            "is not known" if wrench is None else wrench.calibration_fault or "is not calibrated"
        )
        return tripped("no_direction", f"no force can be followed: the wrench {cause}")
    force_N, torque_Nm = hypot(*wrench.force_N), hypot(*wrench.torque_Nm)
    if is_loaded(limits, wrench):
        return _plan_by_force(T_base_tcp, np.array(wrench.force_N), force_N)
    if check_workspace(limits, T_base_tcp) is None:
        text = (
            f"{force_N:.1f} N and {torque_Nm:.2f} N m are below half of the ceilings, and the tool "
            "is inside the workspace: arm, and move it"
        )
        return tripped("already", text, value=force_N, limit=ENDS_BELOW * limits.force_N, unit="N")
    direction = _inside(limits, np.asarray(T_base_tcp.translation)) - T_base_tcp.translation
    return BackOffPlan("workspace", direction * min(1.0, LONGEST_BACK_OFF_M / hypot(*direction)))


def _plan_by_force(T_base_tcp: pin.SE3, force: Array, force_N: float) -> BackOffPlan | Trip:
    if force_N < LEAST_BACK_OFF_FORCE_N:
        text = f"a force of {force_N:.1f} N has no reliable direction: the torque is too high"
        return tripped("no_direction", text, value=force_N, limit=LEAST_BACK_OFF_FORCE_N, unit="N")
    forward = float(force @ T_base_tcp.rotation[:, 2]) / force_N
    if forward > MOST_FORWARD:
        text = "the measured force pulls the tool forward: wrong sign or bias, or tool is hooked"
        return tripped("no_direction", text, value=forward, limit=MOST_FORWARD)
    return BackOffPlan("force", LONGEST_BACK_OFF_M / force_N * force)


def _inside(limits: Limits, p: Array) -> Array:
    """Return a point in the workspace, the nearest to p if the planes are orthogonal."""
    low, high = limits.workspace_min_m + INSIDE_M, limits.workspace_max_m - INSIDE_M
    for _ in range(10):
        p = np.clip(p, low, np.maximum(low, high))
        for plane in limits.planes:
            p = p + max(0.0, float((plane.point_m - p) @ plane.normal) + INSIDE_M) * plane.normal
    return p


def _not_outward(limits: Limits, p: Array, travel: Array) -> Array:
    """Return a path without its small outward part on an axis that is outside."""
    low, high = p < limits.workspace_min_m, p > limits.workspace_max_m
    outward = (low & (travel < 0.0)) | (high & (travel > 0.0))
    little = np.abs(travel) < OUTWARD_SHARE * hypot(*travel)
    return np.where(outward & little, 0.0, travel)


def _inside_part(limits: Limits, T_base_tcp: pin.SE3, path: BackOffPlan) -> BackOffPlan | Trip:
    """Return the part of a path that leads no farther outside, or why that is too short."""
    travel_m = hypot(*path.travel_m)
    for share in np.linspace(1.0, 0.0, 41):
        T = pin.SE3(T_base_tcp.rotation, T_base_tcp.translation + share * path.travel_m)
        if check_workspace(limits, T) is None:
            if share * travel_m < min(SHORTEST_M, travel_m):
                break
            return replace(path, travel_m=share * path.travel_m)
    text = "the path would lead farther out of the workspace: move the planes in the cell file"
    return tripped("workspace", text)


def relaxed_limits(limits: Limits, T_base_tcp: pin.SE3, slack_m: float = 0.0) -> Limits:
    """Return limits for backing off: no farther outside than now, limited travel, no rotation.

    The ceilings are removed: `LoadRatchet` checks the load.
    """
    p = np.asarray(T_base_tcp.translation)
    planes = tuple(
        replace(
            plane,
            point_m=plane.point_m
            - (slack_m + max(0.0, float((plane.point_m - p) @ plane.normal))) * plane.normal,
        )
        for plane in limits.planes
    )
    return replace(
        limits,
        workspace_min_m=np.minimum(limits.workspace_min_m, p) - slack_m,
        workspace_max_m=np.maximum(limits.workspace_max_m, p) + slack_m,
        planes=planes,
        tether_m=LONGEST_BACK_OFF_M + SAME_PATH_M,
        tether_rad=TURN_RAD,
        speed_m_s=min(limits.speed_m_s, SPEED_M_S),
        force_N=inf,
        torque_Nm=inf,
    )


def is_loaded(limits: Limits, wrench: WrenchAtTcp) -> bool:
    """Return whether a force or torque is above half of its ceiling."""
    return (
        hypot(*wrench.force_N) > ENDS_BELOW * limits.force_N
        or hypot(*wrench.torque_Nm) > ENDS_BELOW * limits.torque_Nm
    )


def is_over(
    kind: BackOffKind, limits: Limits, T_base_tcp: pin.SE3, wrench: WrenchAtTcp | None
) -> bool:
    """Return whether the reason for backing off is gone; unknown without a usable force.

    Args:
        kind: Reason for backing off.
        limits: The cell's own.
        T_base_tcp: Pose of the TCP in base.
        wrench: Measured wrench.
    """
    if kind == "force":
        return wrench is not None and not is_loaded(limits, wrench)
    return kind == "workspace" and check_workspace(limits, T_base_tcp) is None


def goal_trip(
    expected: BackOffPlan | Trip, T_from: pin.SE3, T_to: pin.SE3, speed: Speed
) -> Trip | None:
    """Check a goal against the path that this process has computed itself.

    Args:
        expected: Result of `plan` with this process's own readings.
        T_from: Present flange pose in base.
        T_to: The goal, flange in base.
        speed: How fast.
    """
    if isinstance(expected, Trip):
        return expected
    real_m_s = real_speed_m_s(speed)
    if real_m_s > SPEED_M_S * (1.0 + 1e-9):
        text = f"backing off with {real_m_s * 1e3:.1f} mm/s"
        return tripped("speed", text, value=real_m_s, limit=SPEED_M_S, unit="m/s")
    if not is_finite_pose(T_to):
        return tripped("not_finite", "the goal is not finite")
    travel, expected_m = T_to.translation - T_from.translation, hypot(*expected.travel_m)
    travel_m, turn_rad = apart(T_from, T_to)
    if turn_rad > SAME_TURN_RAD:
        text = f"backing off would rotate the tool by {degrees(turn_rad):.2f} degrees"
        return tripped("state", text, value=turn_rad, limit=SAME_TURN_RAD, unit="rad")
    if travel_m > expected_m + SAME_PATH_M:
        text = (
            f"backing off by {travel_m * 1e3:.1f} mm, "
            f"{expected_m * 1e3:.1f} mm are expected from here"
        )
        return tripped("state", text, value=travel_m, limit=expected_m, unit="m")
    if (
        travel_m > SAME_PATH_M
        and float(travel @ expected.travel_m) < SAME_DIRECTION * travel_m * expected_m
    ):
        return tripped("state", "backing off in a direction other than expected from here")
    return None


@dataclass(frozen=True, slots=True)
class LoadRatchet:
    """Lowest load so far, as a ratchet: a later load must not rise much above it."""

    rise_N: float = RISE_N
    rise_Nm: float = RISE_Nm
    first_N: float = inf
    lowest_N: float = inf
    lowest_Nm: float = inf

    def after(self, wrench: WrenchAtTcp, motion: str) -> tuple["LoadRatchet", Trip | None]:
        """Return the load after one more sample, and its rise; `motion` names it in the text."""
        force_N, torque_Nm = hypot(*wrench.force_N), hypot(*wrench.torque_Nm)
        limit_N, limit_Nm = self.lowest_N + self.rise_N, self.lowest_Nm + self.rise_Nm
        trip = None
        if force_N > limit_N:
            text = f"the force rose from {self.lowest_N:.1f} N to {force_N:.1f} N {motion}"
            trip = tripped("force", text, value=force_N, limit=limit_N, unit="N")
        elif torque_Nm > limit_Nm:
            text = f"the torque rose from {self.lowest_Nm:.2f} N m to {torque_Nm:.2f} N m {motion}"
            trip = tripped("torque", text, value=torque_Nm, limit=limit_Nm, unit="N m")
        load = replace(
            self,
            first_N=force_N if self.first_N == inf else self.first_N,
            lowest_N=min(self.lowest_N, force_N),
            lowest_Nm=min(self.lowest_Nm, torque_Nm),
        )
        return load, trip


def motion_trip(
    T_start: pin.SE3, T_base_flange: pin.SE3, time_s: float, load: LoadRatchet
) -> Trip | None:
    """Check travel and speed of an arm that backs off, and whether the force falls.

    Args:
        T_start: Flange in base at the beginning.
        T_base_flange: Measured flange pose in base.
        time_s: Time since the beginning.
        load: Load until now.
    """
    travel_m = hypot(*(T_base_flange.translation - T_start.translation))
    most_m = LATE_M + FAST * SPEED_M_S * time_s
    if travel_m > most_m:
        text = f"the arm moved {travel_m * 1e3:.1f} mm within {time_s:.1f} s while backing off"
        return tripped("speed", text, value=travel_m, limit=most_m, unit="m")
    if time_s > LONGEST_BACK_OFF_S:
        text = f"backing off took longer than {LONGEST_BACK_OFF_S:g} s"
        return tripped("still_loaded", text, value=time_s, limit=LONGEST_BACK_OFF_S, unit="s")
    is_loaded = LEAST_BACK_OFF_FORCE_N < load.lowest_N < inf
    if travel_m > MUST_FALL_AFTER_M and is_loaded and load.first_N - load.lowest_N < MUST_FALL_N:
        text = (
            f"the force is still {load.lowest_N:.1f} N after {travel_m * 1e3:.1f} mm, "
            f"initially {load.first_N:.1f} N: this is no contact force; tare in free space"
        )
        return tripped("still_loaded", text, value=load.lowest_N, limit=load.first_N, unit="N")
    return None

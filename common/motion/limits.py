"""Motion limits. Pure; used by the arbiter and again by the robot's process.

Every check returns a `Trip` with the rule, the finding, the value and the limit. A new limit is a
field of `Limits`, its check, and its place in `ArmBounds`, which both processes use.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees, hypot, isfinite, radians
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import Array, apart, dot, is_finite_pose, plus
from forcemesh.faults import tripped
from forcemesh.messages import Goal, Joints, Speed, Trip, Vec3

NS_PER_S = 1_000_000_000
LEVER_M = 0.1  # a turn is as fast as this lever's end: fm.lever of forcemesh.as


class ApartTexts(NamedTuple):
    """Texts of a limit on the distance and the angle between two poses."""

    names: str  # of the poses
    far: str  # with the distance [mm]
    rotated: str  # with the angle and its limit [degrees]


APART = {
    "step": ApartTexts(
        "the set point or the arm's pose",
        "set point {:.1f} mm away from the arm",
        "set point {:.1f} degrees away from the arm",
    ),
    "tether": ApartTexts(
        "the pose",
        "{:.0f} mm away from the pose at arming",
        "rotated {:.1f} degrees from the pose at arming, limits.tether_deg is {:g}",
    ),
}


@dataclass(frozen=True, slots=True)
class Plane:
    """Workspace plane in base axes; the TCP must stay on the side of the normal."""

    point_m: Array
    normal: Array  # of length 1


@dataclass(frozen=True, slots=True)
class Limits:
    """The cell's limits in SI units."""

    workspace_min_m: Array  # of the TCP, base axes
    workspace_max_m: Array
    joint_min_rad: Array
    joint_max_rad: Array
    joint_speed_rad_s: Array
    step_m: float
    step_rad: float
    speed_m_s: float
    speed_rad_s: float
    accel_m_s2: float
    accel_rad_s2: float
    tether_m: float
    tether_rad: float
    force_N: float
    torque_Nm: float
    move_rise_N: float
    planes: tuple[Plane, ...] = ()

    @classmethod
    def of(cls, cell: CellConfig) -> "Limits":
        """Return the limits of a cell file."""
        limits = cell.limits
        return cls(
            workspace_min_m=np.array(limits.workspace_min_m),
            workspace_max_m=np.array(limits.workspace_max_m),
            joint_min_rad=np.radians(cell.robot.joint_min_deg),
            joint_max_rad=np.radians(cell.robot.joint_max_deg),
            joint_speed_rad_s=limits.joint_speed_share
            * np.radians(cell.robot.joint_speed_max_deg_s),
            step_m=limits.step_m,
            step_rad=radians(limits.step_deg),
            speed_m_s=limits.speed_m_s,
            speed_rad_s=radians(limits.speed_deg_s),
            accel_m_s2=limits.accel_m_s2,
            accel_rad_s2=radians(limits.accel_deg_s2),
            tether_m=limits.tether_m,
            tether_rad=radians(limits.tether_deg),
            force_N=limits.force_N,
            torque_Nm=limits.torque_Nm,
            move_rise_N=limits.move_rise_N,
            planes=tuple(
                Plane(np.array(plane.point_m), np.array(plane.normal) / hypot(*plane.normal))
                for plane in limits.planes
            ),
        )


def check_workspace(limits: Limits, T_base_tcp: pin.SE3) -> Trip | None:
    """Refuse a TCP outside the box or behind a plane, or a pose that is not finite."""
    if not is_finite_pose(T_base_tcp):
        return _not_finite("the pose")
    p = T_base_tcp.translation.tolist()
    bounds = (limits.workspace_min_m.tolist(), limits.workspace_max_m.tolist())
    for axis, value, low, high in zip("xyz", p, *bounds, strict=True):
        if not low <= value <= high:
            broken = low if value < low else high
            text = f"TCP {axis} = {value * 1e3:.1f} mm is outside the workspace"
            return tripped("workspace", text, value=value, limit=broken, unit="m")
    for number, plane in enumerate(limits.planes, start=1):
        beyond_m = dot(plus(plane.point_m.tolist(), p, -1.0), plane.normal.tolist())
        if beyond_m > 0.0:
            text = f"TCP is {beyond_m * 1e3:.1f} mm behind plane {number}"
            return tripped("workspace", text, value=-beyond_m, limit=0.0, unit="m")
    return None


def check_apart(
    code: Literal["step", "tether"], limits: Limits, T_from: pin.SE3, T_to: pin.SE3
) -> Trip | None:
    """Refuse a pose too far from another: a set point from the arm, or a flange from its arming."""
    limit_m, limit_rad = limits.step_m, limits.step_rad
    if code == "tether":
        limit_m, limit_rad = limits.tether_m, limits.tether_rad
    distance_m, angle_rad = apart(T_from, T_to)
    if distance_m < limit_m and angle_rad < limit_rad:
        return None  # and every number is finite
    texts = APART[code]
    if not (is_finite_pose(T_from) and is_finite_pose(T_to)):
        return _not_finite(texts.names)
    if distance_m > limit_m:
        text = texts.far.format(distance_m * 1e3)
        return tripped(code, text, value=distance_m, limit=limit_m, unit="m")
    if angle_rad > limit_rad:
        text = texts.rotated.format(degrees(angle_rad), degrees(limit_rad))
        return tripped(code, text, value=angle_rad, limit=limit_rad, unit="rad")
    return None


def check_joints(
    limits: Limits, joint_rad: Joints | Array, *, slack_rad: float = 0.0
) -> Trip | None:
    """Refuse joint angles of another arm, or outside the arm's range, with a tolerance."""
    count, expected = len(joint_rad), len(limits.joint_min_rad)
    if count != expected:
        text = f"{count} joint angles, the arm of the cell file has {expected} joints"
        return tripped("joint_count", text, value=count, limit=expected)
    bounds = (limits.joint_min_rad.tolist(), limits.joint_max_rad.tolist())
    for number, (angle, lowest, highest) in enumerate(zip(joint_rad, *bounds, strict=True), 1):
        if not lowest - slack_rad <= angle <= highest + slack_rad:
            if not all(map(isfinite, joint_rad)):
                return _not_finite("a joint angle")
            broken = lowest - slack_rad if angle < lowest else highest + slack_rad
            text = f"joint {number} = {degrees(angle):.1f} degrees is out of its range"
            return tripped("joint", text, value=float(angle), limit=broken, unit="rad")
    return None


def check_speed(limits: Limits, speed: Speed) -> Trip | None:
    """Refuse a move whose speed, mechanical times modular, is above the limit."""
    if real_speed_m_s(speed) <= limits.speed_m_s:
        return None
    text = "mechanical times modular speed is above limits.speed_m_s"
    return tripped("speed", text, value=real_speed_m_s(speed), limit=limits.speed_m_s, unit="m/s")


def real_speed_m_s(speed: Speed) -> float:
    """Return the speed of a move: mechanical times modular (specification 1.4 e)."""
    return speed.mechanical_m_s * speed.modular_fraction


def check_wrench(limits: Limits, force_N: Vec3 | Array, torque_Nm: Vec3 | Array) -> Trip | None:
    """Refuse a wrench above the force or torque ceiling."""
    force, torque = hypot(*force_N), hypot(*torque_Nm)
    if force < limits.force_N and torque < limits.torque_Nm:
        return None  # and every number is finite
    if not all(map(isfinite, (*force_N, *torque_Nm))):
        return _not_finite("the wrench")
    if force > limits.force_N:
        text = f"force {force:.1f} N is above the ceiling"
        return tripped("force", text, value=force, limit=limits.force_N, unit="N")
    if torque > limits.torque_Nm:
        text = f"torque {torque:.2f} N m is above the ceiling"
        return tripped("torque", text, value=torque, limit=limits.torque_Nm, unit="N m")
    return None


def _not_finite(what: str) -> Trip:
    return tripped("not_finite", f"{what} holds a number that is not finite")


# --- the limits of an armed arm -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ArmBounds:
    """The limits that apply since the arm was armed: to poses, and to the end of a move."""

    limits: Limits
    T_flange_tcp: pin.SE3
    T_armed: pin.SE3  # flange in base: origin of the tether

    def place(self, T_base_flange: pin.SE3) -> Trip | None:
        """Check a flange pose: its TCP in the workspace, the flange within the tether."""
        limits, T_base_tcp = self.limits, T_base_flange * self.T_flange_tcp
        return check_workspace(limits, T_base_tcp) or check_apart(
            "tether", limits, self.T_armed, T_base_flange
        )

    def goal(self, goal: Goal, joint_rad: Joints | Array) -> Trip | None:
        """Check the end of a move that starts at these joint angles."""
        if goal.kind == "pose":
            if goal.pose is None:
                return tripped("malformed", "a move to a pose needs a pose")
            return self.place(pose_of(goal.pose))
        if goal.joint_rad is None:
            return tripped("malformed", f"a move of kind {goal.kind} needs joint_rad")
        if len(goal.joint_rad) != len(self.limits.joint_min_rad):
            return check_joints(self.limits, goal.joint_rad)  # refused by their number
        return check_joints(self.limits, joint_goal(goal, joint_rad))


def joint_goal(goal: Goal, joint_rad: Joints | Array) -> Array:
    """Return the joint angles at the end of a joint move. Shape (6,) [rad]."""
    turn_rad = np.array(goal.joint_rad)
    return turn_rad + np.array(joint_rad) if goal.kind == "by" else turn_rad


def slowed(bounds: ArmBounds, speed_m_s: float | None) -> ArmBounds:
    """Return bounds with a lower speed, whose turns are those of LEVER_M; None: unchanged."""
    if speed_m_s is None:
        return bounds
    limits = replace(
        bounds.limits,
        speed_m_s=min(bounds.limits.speed_m_s, speed_m_s),
        speed_rad_s=min(bounds.limits.speed_rad_s, speed_m_s / LEVER_M),
    )
    return replace(bounds, limits=limits)


def share_at(fastest: float, error: Sequence[float], gain: Sequence[float]) -> float:
    """Return the share of an error with which integral gains move no faster than `fastest`.

    Args:
        fastest: Highest speed, in the unit of gain times error.
        error: Reading minus set point (3,).
        gain: Integral gains of the three axes.
    """
    speed = hypot(*(g * e for g, e in zip(gain, error, strict=True)))
    return min(1.0, fastest / speed) if speed > 0.0 else 1.0

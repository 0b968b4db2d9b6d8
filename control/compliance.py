"""Compliance of single axes of a task frame, with force control along the others. Pure.

Along each compliant axis a virtual mass, damper and spring respond to the force (N. Hogan,
Impedance control, 1985):

    M dv/dt = F' - D v - K x,    D >= (k + K) tau / 0.45

x is the deviation from the reference. Mass and damping are at least those of hand guiding
(`admittance.py`), which are stable on a contact of stiffness k behind the loop delay. About an
axis, the damping is at least the inverse of the torque integral gain.
"""

from dataclasses import dataclass, field
from typing import Self

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import (
    Speeds,
    Vector,
    cross,
    moved,
    plus,
    product,
    rotated,
    rotated_back,
    scaled,
    speeds_between,
)
from control.admittance import (
    MASSES,
    AdmittanceSettings,
    AdmittanceState,
    virtual_speed,
    virtual_step,
)
from control.admittance import begin as begin_guiding
from control.axis_task import AxisTask, VirtualMass, clipped
from control.law import LawInput, LawMotion, about_origin, limit_norm, task_deadband
from forcemesh.messages import ZERO3, AxisState, Vec3
from forcemesh.requests import ForceTask

AT_LIMIT = 0.999  # of its deviation: an axis there is at the limit
LEAST_GAIN = 1e-9  # a request may set the torque gain to zero


@dataclass(frozen=True, slots=True)
class ComplianceSettings:
    """Constants of compliance for one cell."""

    guiding: AdmittanceSettings
    inertia_kg_m2: float
    speed_max_rad_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "ComplianceSettings":
        """Return the constants of a cell."""
        inertia_kg_m2 = MASSES * cell.plant.inertia_kg_m2
        return cls(AdmittanceSettings.of(cell), inertia_kg_m2, cell.force.speed_max_rad_s)


@dataclass(slots=True)
class ComplianceState:
    """Reference and virtual speeds; advanced in place."""

    axes: tuple[object, ...]  # those that refer to the reference, with their deviations
    T_reference: pin.SE3  # of the TCP in base; a path moves it
    shifting: AdmittanceState
    speed_rad_s: Vector = ZERO3  # about the axes of the task frame
    at_limit: list[bool] = field(default_factory=lambda: [False] * 6)

    @classmethod
    def at(
        cls, task: AxisTask, T_base_tcp: pin.SE3, T_measured: pin.SE3, settings: ComplianceSettings
    ) -> Self:
        """Return the state of a tool at rest at its reference."""
        shifting = begin_guiding(T_base_tcp, T_measured, None, settings.guiding)
        return cls(referring(task), T_base_tcp.copy(), shifting)

    def covers(self, task: AxisTask) -> bool:
        """Return whether the reference stays for a changed task: the same axes refer to it."""
        return referring(task) == self.axes

    def move(self, travel: Speeds) -> None:
        """Move the reference by shift and rotation about the TCP, base axes."""
        self.T_reference = moved(self.T_reference, travel, 1.0)

    def deviation(self, T_base_tcp: pin.SE3, sample: LawInput) -> tuple[Vec3, Vec3]:
        """Return travel [m] and rotation [rad] from the reference, task axes. Shapes (3,)."""
        moved_m, turned_rad = speeds_between(self.T_reference, T_base_tcp, 1.0)
        R = sample.R_base_task
        return rotated_back(R, moved_m), rotated_back(R, turned_rad)


def referring(task: AxisTask) -> tuple[object, ...]:
    """Return the axes of a task that refer to a reference, and their limits."""
    return tuple(each is not None for each in (*task.shifts, *task.swings)), task.deviations


def comply(
    state: ComplianceState, sample: LawInput, motion: LawMotion, settings: ComplianceSettings
) -> LawMotion:
    """Return the motion of force control with that of the compliant axes, within deviations.

    Force control and compliance together keep the speed limit of force feedback.
    """
    task, before = sample.task, sample.motion.T_base_tcp
    T = motion.T_base_tcp
    if task.complies:
        shift_m, turn_rad = _compliant_steps(state, sample, settings)
        moved_m, turned_rad = speeds_between(before, T, 1.0)
        most_m = settings.guiding.plain.speed_max_m_s * sample.dt_s
        turn_rad = limit_norm(plus(turned_rad, turn_rad), settings.speed_max_rad_s * sample.dt_s)
        shift_m = limit_norm(plus(moved_m, shift_m), most_m)
        if task.origin_m is not None:  # what force control turned is on its arc already
            swung_m = cross(turned_rad, sample.arm_m)
            shift_m = plus(shift_m, swung_m, -1.0)
            shift_m, turn_rad = about_origin(sample, shift_m, turn_rad, most_m)
        T = moved(before, (shift_m, turn_rad), 1.0)
    motion.T_base_tcp = _within_deviations(state, sample, T)
    return motion


def axis_states(task: ForceTask, sample: LawInput, state: ComplianceState) -> tuple[AxisState, ...]:
    """Return the present state of each axis, for the target of the regulator."""
    R, now = sample.R_base_task, sample.task
    loads = (*rotated_back(R, sample.force_N), *rotated_back(R, sample.task_torque_Nm()))
    away_m, away_rad = state.deviation(sample.motion.T_base_tcp, sample)
    values = zip(
        task.axes,
        (*now.force_N, *now.torque_Nm),
        loads,
        (*away_m, *away_rad),
        state.at_limit,
        strict=True,
    )
    return tuple(
        AxisState(
            control=axis.control,
            setpoint=setpoint,
            exerted=-load,
            deviation=deviation,
            at_limit=at_limit,
        )
        for axis, setpoint, load, deviation, at_limit in values
    )


def _compliant_steps(
    state: ComplianceState, sample: LawInput, settings: ComplianceSettings
) -> tuple[Vec3, Vec3]:
    """Return shift [m] and rotation [rad] of the compliant axes in this period, base axes."""
    task, dt_s, R = sample.task, sample.dt_s, sample.R_base_task
    away_m, away_rad = state.deviation(sample.motion.T_base_tcp, sample)
    speed_m_s = virtual_speed(
        state.shifting, sample, settings.guiding, masses=task.shifts, deviation_m=away_m
    )
    state.shifting.speed_m_s = clipped(speed_m_s, task.speeds[0])
    shift_m = rotated(R, scaled(state.shifting.speed_m_s, dt_s))
    state.speed_rad_s = clipped(_swing_speeds(state, sample, settings, away_rad), task.speeds[1])
    return shift_m, rotated(R, scaled(state.speed_rad_s, dt_s))


def _swing_speeds(
    state: ComplianceState, sample: LawInput, settings: ComplianceSettings, away_rad: Vec3
) -> Vector:
    """Return the angular speeds of the compliant axes, task axes [rad/s]. Shape (3,)."""
    task, gains = sample.task, sample.gains.torque_i_rad_per_Nms
    if not any(task.swings):
        return ZERO3
    complies = [each is not None for each in task.swings]
    torque_Nm = product(rotated_back(sample.R_base_task, sample.task_torque_Nm()), complies)
    width_Nm = settings.guiding.plain.deadband_Nm
    load_Nm = task_deadband(torque_Nm, width_Nm, 0.0, task.deadbands[1])
    least = 1.0 / max(min(gains), LEAST_GAIN)
    used = [each or VirtualMass() for each in task.swings]
    loads = zip(state.speed_rad_s, load_Nm, used, away_rad, strict=True)
    speeds = [
        virtual_step(
            w, M, damping=max(least, each.damping or 0.0), virtual=each,
            least_mass=settings.inertia_kg_m2, deviation=angle, dt_s=sample.dt_s,
        )
        for w, M, each, angle in loads
    ]  # fmt: skip
    return product(speeds, complies)


def _within_deviations(state: ComplianceState, sample: LawInput, T_base_tcp: pin.SE3) -> pin.SE3:
    """Return the pose within the largest deviations from the reference, and note the limits."""
    limits_m, limits_rad = sample.task.deviations
    if not any(limit is not None for limit in (*limits_m, *limits_rad)):
        return T_base_tcp
    away_m, away_rad = state.deviation(T_base_tcp, sample)
    kept_m, kept_rad = clipped(away_m, limits_m), clipped(away_rad, limits_rad)
    pairs = zip((*away_m, *away_rad), (*limits_m, *limits_rad), strict=True)
    state.at_limit = [limit is not None and abs(away) > AT_LIMIT * limit for away, limit in pairs]
    if (kept_m, kept_rad) == (away_m, away_rad):
        return T_base_tcp
    R = sample.R_base_task
    return moved(state.T_reference, (rotated(R, kept_m), rotated(R, kept_rad)), 1.0)

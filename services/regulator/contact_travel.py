"""Travel of the contact point, commanded and measured, passed through the delay model. Pure.

A rotation about the TCP moves that point too. Travel is accumulated along the tool axes of each
period, so that a later rotation does not turn travel across the tool axis into travel along it.
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, cross, rotation_between
from services.regulator import delay_model as path
from services.regulator.delay_model import DelayModelSettings, LoopDelayModel
from services.regulator.law import LawInput, LawState


@dataclass(frozen=True, slots=True)
class ContactTravel:
    """Travel of the contact point so far."""

    T_base_tcp: pin.SE3  # at its end
    path: LoopDelayModel  # base axes
    felt_m: Array  # travel that the filtered force belongs to, tool axes. Shape (3,)


@dataclass(frozen=True, slots=True)
class MeasuredTravel:
    """Measured travel, updated once per robot report."""

    way: ContactTravel
    waits_s: float = 0.0
    took_s: float = 0.0  # between the last two reports

    @property
    def is_new(self) -> bool:
        """Whether the last step contained a new report."""
        return self.waits_s == 0.0


def begin(T_base_tcp: pin.SE3) -> ContactTravel:
    """Return the travel of a tool at rest."""
    zero = np.zeros(3)
    return ContactTravel(T_base_tcp.copy(), path.at_rest(zero), zero)


def update_commanded(
    way: ContactTravel, law: LawState, dt_s: float, settings: DelayModelSettings
) -> ContactTravel:
    """Return the travel up to the commanded pose, constant for the last `dt_s`."""
    return _gone(way, law.T_base_tcp, law, dt_s=dt_s, settings=settings)


def update_measured(
    reports: MeasuredTravel,
    law: LawState,
    T_measured: pin.SE3,
    *,
    sample: LawInput,
    settings: DelayModelSettings,
) -> MeasuredTravel:
    """Return the travel up to the measured pose, updated when a new one is reported.

    Between two reports the pose is older than the force: paired with it, a stiff contact would
    look soft.
    """
    waits_s = reports.waits_s + sample.dt_s
    if not sample.pose_is_new:
        return replace(reports, waits_s=waits_s)
    wrench_only = DelayModelSettings(settings.median_s, 0.0, settings.filter_s, settings.median_s)
    way = _gone(reports.way, T_measured, law, dt_s=waits_s, settings=wrench_only)
    return MeasuredTravel(way, 0.0, waits_s)


def _gone(
    way: ContactTravel,
    T_base_tcp: pin.SE3,
    law: LawState,
    *,
    dt_s: float,
    settings: DelayModelSettings,
) -> ContactTravel:
    lever_m = np.zeros(3) if law.lever_m is None else law.lever_m
    turn_rad = rotation_between(way.T_base_tcp.rotation, T_base_tcp.rotation)
    shift_m = T_base_tcp.translation - way.T_base_tcp.translation
    end_m = way.path.command + shift_m + cross(turn_rad, lever_m)
    gone = path.follow(way.path, end_m, dt_s, settings)
    felt_m = law.T_base_tcp.rotation.T @ (gone.felt - way.path.felt)
    return ContactTravel(T_base_tcp, gone, way.felt_m + felt_m)

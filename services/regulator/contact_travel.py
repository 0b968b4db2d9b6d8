"""Travel of the contact point, commanded and measured, passed through the delay model. Pure.

A rotation about the TCP moves that point too. Travel is accumulated along the tool axes of each
period, so that a later rotation does not turn travel across the tool axis into travel along it.
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, cross, rotation_between
from services.regulator import delay_model
from services.regulator.delay_model import DelayModelSettings, LoopDelayModel
from services.regulator.law import LawInput, LawState


@dataclass(frozen=True, slots=True)
class ContactTravel:
    """Travel of the contact point so far."""

    T_base_tcp: pin.SE3  # at its end
    delay_model: LoopDelayModel  # base axes
    filtered_travel_m: Array  # travel that the filtered force belongs to, tool axes. Shape (3,)


@dataclass(frozen=True, slots=True)
class MeasuredTravel:
    """Measured travel, updated once per robot report."""

    travel: ContactTravel
    since_report_s: float = 0.0
    report_period_s: float = 0.0  # between the last two reports

    @property
    def is_new(self) -> bool:
        """Whether the last step contained a new report."""
        return self.since_report_s == 0.0


def begin(T_base_tcp: pin.SE3) -> ContactTravel:
    """Return the travel of a tool at rest."""
    zero = np.zeros(3)
    return ContactTravel(T_base_tcp.copy(), delay_model.at_rest(zero), zero)


def update_commanded(
    travel: ContactTravel, law: LawState, dt_s: float, settings: DelayModelSettings
) -> ContactTravel:
    """Return the travel up to the commanded pose, constant for the last `dt_s`."""
    return _advance(travel, law.T_base_tcp, law, dt_s=dt_s, settings=settings)


def update_measured(
    before: MeasuredTravel,
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
    since_report_s = before.since_report_s + sample.dt_s
    if not sample.pose_is_new:
        return replace(before, since_report_s=since_report_s)
    wrench_only = DelayModelSettings(settings.median_s, 0.0, settings.filter_s, settings.median_s)
    travel = _advance(before.travel, T_measured, law, dt_s=since_report_s, settings=wrench_only)
    return MeasuredTravel(travel, 0.0, since_report_s)


def _advance(
    travel: ContactTravel,
    T_base_tcp: pin.SE3,
    law: LawState,
    *,
    dt_s: float,
    settings: DelayModelSettings,
) -> ContactTravel:
    lever_m = np.zeros(3) if law.lever_m is None else law.lever_m
    turn_rad = rotation_between(travel.T_base_tcp.rotation, T_base_tcp.rotation)
    shift_m = T_base_tcp.translation - travel.T_base_tcp.translation
    end_m = travel.delay_model.command + shift_m + cross(turn_rad, lever_m)
    model = delay_model.follow(travel.delay_model, end_m, dt_s, settings)
    filtered_travel_m = law.T_base_tcp.rotation.T @ (model.filtered - travel.delay_model.filtered)
    return ContactTravel(T_base_tcp, model, travel.filtered_travel_m + filtered_travel_m)

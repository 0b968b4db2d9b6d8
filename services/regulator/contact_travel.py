"""The way of the point of contact, as commanded and as measured, up to where the force feels it.

Pure. A turn about the TCP moves that point too. Ways are added up along the tool's axes as they
were then: a tool that turns after a long way across has not moved along its axis.
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, cross, rotation_between
from services.regulator import delay_model as path
from services.regulator.delay_model import Path, PathSettings
from services.regulator.law import LawInput, LawState


@dataclass(frozen=True, slots=True)
class Way:
    """One way so far."""

    T_base_tcp: pin.SE3  # at its end
    path: Path  # base axes
    felt_m: Array  # what `felt` of it has come to, tool axes. Shape (3,)


@dataclass(frozen=True, slots=True)
class Reports:
    """The measured way: it is one report longer, or has waited for the next one."""

    way: Way
    waits_s: float = 0.0
    took_s: float = 0.0  # from the report before to the last one

    @property
    def is_new(self) -> bool:
        """Whether the last step has made it longer."""
        return self.waits_s == 0.0


def begin(T_base_tcp: pin.SE3) -> Way:
    """Return the way of a tool at rest."""
    zero = np.zeros(3)
    return Way(T_base_tcp.copy(), path.at_rest(zero), zero)


def commanded(way: Way, law: LawState, dt_s: float, settings: PathSettings) -> Way:
    """Return the way to the commanded pose, which has held for the last `dt_s`."""
    return _gone(way, law.T_base_tcp, law, dt_s=dt_s, settings=settings)


def reported(
    reports: Reports,
    law: LawState,
    T_measured: pin.SE3,
    *,
    sample: LawInput,
    settings: PathSettings,
) -> Reports:
    """Return the way to the measured pose, once a new one has come.

    In between the pose is as old as the force is not: paired with it, a stiff contact would seem
    soft.
    """
    waits_s = reports.waits_s + sample.dt_s
    if not sample.pose_is_new:
        return replace(reports, waits_s=waits_s)
    wrench_only = PathSettings(settings.median_s, 0.0, settings.filter_s, settings.median_s)
    way = _gone(reports.way, T_measured, law, dt_s=waits_s, settings=wrench_only)
    return Reports(way, 0.0, waits_s)


def _gone(
    way: Way,
    T_base_tcp: pin.SE3,
    law: LawState,
    *,
    dt_s: float,
    settings: PathSettings,
) -> Way:
    lever_m = np.zeros(3) if law.lever_m is None else law.lever_m
    turn_rad = rotation_between(way.T_base_tcp.rotation, T_base_tcp.rotation)
    shift_m = T_base_tcp.translation - way.T_base_tcp.translation
    end_m = way.path.command + shift_m + cross(turn_rad, lever_m)
    gone = path.follow(way.path, end_m, dt_s, settings)
    felt_m = law.T_base_tcp.rotation.T @ (gone.felt - way.path.felt)
    return Way(T_base_tcp, gone, way.felt_m + felt_m)

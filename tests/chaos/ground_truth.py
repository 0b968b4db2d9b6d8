"""Ground-truth motion of the flange, from the trace of the simulated arm. Pure except reading."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array
from common.motion.kinematics import ArmKinematics
from sim.robot.settings import TICK_S
from sim.robot.trace import Records

WINDOW_TICKS = 10  # a speed is the travel over 10 ms
STRIDE_TICKS = 2
STILL_M_S = 1e-3
STILL_FOR_S = 0.1


@dataclass(frozen=True, slots=True)
class FlangePath:
    """Flange path of one arm process: time [ns] (n,), position [m] (n, 3), speed [m/s]."""

    at_ns: npt.NDArray[np.int64]
    position_m: Array
    speed_m_s: Array

    def between(self, since_ns: float, until_ns: float) -> "FlangePath":
        """Return the part within a time window."""
        inside = (self.at_ns >= since_ns) & (self.at_ns <= until_ns)
        return FlangePath(self.at_ns[inside], self.position_m[inside], self.speed_m_s[inside])

    @property
    def has_samples(self) -> bool:
        """Whether the path has any samples."""
        return len(self.at_ns) > 0

    @property
    def fastest_m_s(self) -> float:
        """Largest speed; 0 without samples."""
        return float(self.speed_m_s.max()) if self.has_samples else 0.0

    @property
    def spread_m(self) -> float:
        """Largest distance from the start."""
        if not self.has_samples:
            return 0.0
        return float(np.linalg.norm(self.position_m - self.position_m[0], axis=1).max())

    def still_since_ns(self) -> int | None:
        """Return the start of the first 0.1 s slower than 1 mm/s, or None."""
        fast = np.flatnonzero(self.speed_m_s >= STILL_M_S)
        edges = [-1, *fast.tolist(), len(self.at_ns)]
        for before, after in pairwise(edges):
            quiet = self.at_ns[before + 1 : after]
            if len(quiet) and (quiet[-1] - quiet[0]) * 1e-9 >= STILL_FOR_S:
                return int(quiet[0])
        return None


def paths(records: Records) -> list[FlangePath]:
    """Return the flange's path for each arm process, in order.

    Speeds use the arm's own ticks: catching up after a delay does not increase them.
    """
    kinematics = ArmKinematics("rs007l")
    return [_path(each, kinematics) for each in _processes(records)]


def _processes(records: Records) -> Iterator[Records]:
    starts = np.flatnonzero(np.diff(records["tick"]) < 0) + 1
    yield from (process for process in np.split(records, starts) if len(process) > WINDOW_TICKS)


def _path(records: Records, kinematics: ArmKinematics) -> FlangePath:
    part = records[::STRIDE_TICKS]
    position_m = np.array([kinematics.flange_pose(q).translation for q in part["q"]])
    step = WINDOW_TICKS // STRIDE_TICKS
    travel_m = np.linalg.norm(position_m[step:] - position_m[:-step], axis=1)
    return FlangePath(part["at_ns"][step:], position_m[step:], travel_m / (WINDOW_TICKS * TICK_S))

"""Evaluation of one trial against the ground-truth trace of the arm. Pure except file reading.

fault ──► last command accepted ──► flange below 1 mm/s ──► heal ──► end: still at rest
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array
from common.motion.kinematics import ArmKinematics
from sim.robot.settings import TICK_S
from sim.robot.trace import RECORD

MOVES_M_S = 2e-3  # a fault counts only while the flange is faster than this
STILL_M_S = 1e-3
WINDOW = 10  # ticks over which a speed is taken
APPROACH_TICKS = 100  # ticks for the approach speed: a controller's steps stop in between
MS = 1e6  # nanoseconds

Moments = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TrialBounds:
    """Bounds of a trial."""

    last_command_s: float
    still_s: float
    fastest_m_s: float  # also if the arm continues


@dataclass(frozen=True, slots=True)
class TrialObservations:
    """Observations of a trial; times are CLOCK_MONOTONIC [ns]."""

    began_ns: int
    healed_ns: int
    accepted_ns: int | None  # last command executed by the robot process
    held: bool
    causes: str
    bites: int
    ends: str  # expected result: held, went on, either
    stall_s: float  # longest delay of the idle witness during the trial


@dataclass(frozen=True, slots=True)
class TrialVerdict:
    """Result of a trial: one row of the table."""

    outcome: str
    last_command_ms: float | None
    still_ms: float | None
    stale: int
    fastest_m_s: float
    mistakes: tuple[str, ...]


class GroundTruthTrace:
    """Ground-truth trace of the arm's motion."""

    def __init__(self, path: Path) -> None:
        """Read from a growing file."""
        self._path = path
        self._kinematics = ArmKinematics("rs007l")

    def mark(self) -> int:
        """Return the current number of records, as a start for later reads."""
        return self._path.stat().st_size // RECORD.itemsize if self._path.exists() else 0

    def speeds(self, since: int) -> tuple[Moments, Array]:
        """Return moments [ns] and true flange speeds [m/s] after a mark. Shapes (n,), (n,)."""
        count = self.mark() - since
        if count <= WINDOW:
            return np.zeros(0, np.int64), np.zeros(0)
        rows = np.fromfile(self._path, RECORD, count=count, offset=since * RECORD.itemsize)
        places = np.array([self._kinematics.flange_pose(q).translation for q in rows["q"]])
        travel_m = np.linalg.norm(places[WINDOW:] - places[:-WINDOW], axis=1)
        # Ticks are the arm's own time: catching up after a delay does not appear as speed.
        took_s = (rows["tick"][WINDOW:] - rows["tick"][:-WINDOW]) * TICK_S
        return rows["at_ns"][WINDOW:].astype(np.int64), travel_m / took_s

    def speed_now(self) -> float:
        """Return the recent mean speed of the flange [m/s], 0 without a trace."""
        _, speeds = self.speeds(max(0, self.mark() - APPROACH_TICKS - WINDOW))
        return float(speeds.mean()) if len(speeds) else 0.0


def judge(
    observed: TrialObservations, at_ns: Moments, speed_m_s: Array, bounds: TrialBounds
) -> TrialVerdict:
    """Return the verdict of a trial; mistakes are empty if all bounds are met."""
    after = at_ns >= observed.began_ns
    moving = at_ns[after & (speed_m_s > STILL_M_S)]
    fastest = float(speed_m_s[after].max(initial=0.0))
    mistakes = [] if observed.bites else ["the fault had no effect"]
    if not after.any():
        mistakes.append("no trace of the arm")
    if fastest > bounds.fastest_m_s:
        mistakes.append(f"jumped: {fastest * 1e3:.0f} mm/s")
    if not observed.held:
        if observed.ends == "held":
            mistakes.append("the arm was not held")
        return TrialVerdict("went on", None, None, 0, fastest, tuple(mistakes))
    still_ms = (moving[-1] - observed.began_ns) / MS if len(moving) else 0.0
    accepted_ms = (
        None if observed.accepted_ns is None else (observed.accepted_ns - observed.began_ns) / MS
    )
    mistakes += _of_a_hold(observed, accepted_ms, still_ms, bounds)
    stale = int(observed.ends == "held" and _after_heal(observed))
    return TrialVerdict("held", accepted_ms, still_ms, stale, fastest, tuple(mistakes))


def _of_a_hold(
    observed: TrialObservations, accepted_ms: float | None, still_ms: float, bounds: TrialBounds
) -> Iterator[str]:
    """Yield the violations of a trial with a hold."""
    if observed.ends == "went on":
        yield "held without need"
    if not observed.causes:
        yield "no cause was given"
    if accepted_ms is None:
        yield "no command was recorded"
    elif observed.ends != "held":  # the effect may be delayed: measured from the last command
        if still_ms - accepted_ms > bounds.still_s * 1e3:
            yield "moved long after a command"
    elif accepted_ms > bounds.last_command_s * 1e3:
        yield "a command was executed too late"
    if observed.ends == "held" and still_ms > bounds.still_s * 1e3:
        yield "moved too long"
    if observed.ends == "held" and _after_heal(observed):
        yield "a command was executed after the heal without a new arming"


def _after_heal(observed: TrialObservations) -> bool:
    return observed.accepted_ns is not None and observed.accepted_ns > observed.healed_ns

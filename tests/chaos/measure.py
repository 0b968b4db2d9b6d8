"""Evaluation of an injection from trace, recorded messages and witness."""

from dataclasses import dataclass

from forcemesh import topics
from forcemesh.clock import NS_PER_S
from tests.chaos.ground_truth import FlangePath, paths
from tests.chaos.outcome import LAST_ACCEPTED_S, MOVING_M_S, Outcome
from tests.chaos.recorder_client import RecordedMessages
from tests.chaos.rig import Rig
from tests.chaos.witness import STALL_S

BEFORE_NS = round(0.5 * NS_PER_S)  # part of the path before the fault that is checked for jumps
# A machine stall within these times invalidates the measurement.
STALL_BEFORE_NS, STALL_AFTER_NS = round(0.1 * NS_PER_S), round(0.7 * NS_PER_S)


class InvalidTrialError(Exception):
    """Error: the trial is invalid for a reason outside the cell."""


@dataclass(frozen=True, slots=True)
class Window:
    """Times of the injection [ns]."""

    began_ns: int  # a process whose memory is exhausted becomes slow before it ends
    fault_ns: int
    thaw_ns: int  # 0 unless it was frozen
    end_ns: int


def measure(outcome: Outcome, window: Window, rig: Rig, notes: RecordedMessages) -> None:
    """Fill an outcome with the measurements.

    Raises InvalidTrialError if the machine stalled, or if the arm was not moving when it began.
    """
    since_ns = window.fault_ns - BEFORE_NS
    _refuse_stalls(outcome, window, rig)
    paths_of_arm = [
        path_of_arm.between(since_ns, window.end_ns)
        for path_of_arm in paths(rig.trace_since(since_ns))
    ]
    _refuse_rest(outcome, paths_of_arm, window)
    outcome.fastest_m_s = max(path_of_arm.fastest_m_s for path_of_arm in paths_of_arm)
    _measure_commands(outcome, window, notes, rig.cell.stale_after_s(topics.ROBOT_COMMAND))
    if not outcome.continued:
        _measure_path(outcome, window, paths_of_arm)


def _refuse_stalls(outcome: Outcome, window: Window, rig: Rig) -> None:
    edges = [window.fault_ns, *([window.thaw_ns] if window.thaw_ns else [])]
    outcome.stalled_s = max(
        rig.witness.worst_s(edge - STALL_BEFORE_NS, edge + STALL_AFTER_NS) for edge in edges
    )
    if outcome.stalled_s > STALL_S:
        raise InvalidTrialError(f"the machine stalled for {outcome.stalled_s * 1e3:.0f} ms")


def _refuse_rest(outcome: Outcome, paths_of_arm: list[FlangePath], window: Window) -> None:
    before = [path_of_arm.between(0, window.began_ns) for path_of_arm in paths_of_arm]
    outcome.speed_m_s = next(
        (float(path.speed_m_s[-1]) for path in before if path.has_samples), 0.0
    )
    if outcome.speed_m_s < MOVING_M_S:
        raise InvalidTrialError(f"it moved with {outcome.speed_m_s * 1e3:.1f} mm/s only")


def _measure_commands(
    outcome: Outcome, window: Window, notes: RecordedMessages, limit_s: float
) -> None:
    """Evaluate the commands accepted for motion, and their age."""
    times = [at_ns for at_ns, _ in notes.accepted.values()]
    ages = [age_s for _, age_s in notes.accepted.values()]
    outcome.oldest_accepted_s = max(ages, default=0.0)
    outcome.stale = sum(age_s > limit_s for age_s in ages)
    if outcome.continued:
        return
    # Commands accepted after the bound, or after a thaw, are violations.
    after_ns = window.fault_ns + round(LAST_ACCEPTED_S * NS_PER_S)
    after_ns = max(after_ns, window.thaw_ns)
    outcome.stale += sum(at_ns > after_ns for at_ns in times)
    case = outcome.case
    if not (case.hits_the_robot and not case.frozen_s):  # its memory is gone with it
        last_ns = max(times, default=window.fault_ns)
        outcome.last_accepted_s = max(0, last_ns - window.fault_ns) / NS_PER_S


def _measure_path(outcome: Outcome, window: Window, paths_of_arm: list[FlangePath]) -> None:
    """Evaluate the time to standstill, and motion after it."""
    case = outcome.case
    outcome.arm_ended = case.hits_the_arm and not case.frozen_s
    if outcome.arm_ended:  # a new arm process starts at rest and must stay at rest
        outcome.moved_m = max(
            (path_of_arm.spread_m for path_of_arm in paths_of_arm[1:]), default=0.0
        )
        return
    # The time of a frozen arm stands still: it brakes after the thaw.
    base_ns = window.thaw_ns if case.hits_the_arm else window.fault_ns
    path = paths_of_arm[0].between(base_ns, window.end_ns)
    still_ns = path.still_since_ns()
    if still_ns is not None:
        outcome.still_s = (still_ns - base_ns) / NS_PER_S
        outcome.moved_m = path.between(still_ns, window.end_ns).spread_m

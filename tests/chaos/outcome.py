"""Outcome of one injection, the bounds it violates, and the journal of a resumable run."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tests.chaos.cases import Case, CellName

LAST_ACCEPTED_S = 0.150  # with real processes; the demo cells' deadline is 80 ms
STILL_SIM_S = 0.350
RAMP_S = 0.150  # of the arm: from 250 mm/s in 100 ms, delay and smoothing of its set points
LOOP_S = 0.045  # of the controller's program, from a packet to the arm
MOVING_M_S = 2e-3  # minimum flange speed at the fault
JUMP_MARGIN = 1.25  # factor on the cell's speed limit
DRIFT_M = 5e-4  # permitted settling in contact after standstill


@dataclass(frozen=True, slots=True)
class OutcomeLimits:
    """Limits of the cell for the evaluation."""

    command_s: float  # deadline of the command stream
    watchdog_s: float  # of the controller's program; 0 without a controller
    speed_m_s: float

    @property
    def still_s(self) -> float:
        """Bound on the time to standstill [s]."""
        if not self.watchdog_s:
            return STILL_SIM_S
        return self.watchdog_s + LOOP_S + RAMP_S


@dataclass(slots=True)
class Outcome:
    """Measurements; times [s] from the fault, or from the thaw if the arm was frozen."""

    case: Case
    speed_m_s: float = 0.0  # of the flange at the fault
    continued: bool = False  # the cell did not hold
    last_accepted_s: float | None = None
    still_s: float | None = None  # None: the arm ended with its process
    arm_ended: bool = False
    stale: int = 0  # commands accepted past their deadline, or after a thaw
    oldest_accepted_s: float = 0.0
    moved_m: float = 0.0  # travel from standstill until arming
    fastest_m_s: float = 0.0
    provoked: list[str] = field(default_factory=list)  # wrongly accepted without arming
    causes: list[str] = field(default_factory=list)  # of arbiter/status
    status_shows: bool = False  # `forcemesh status` names the cause or the process
    stalled_s: float = 0.0  # longest delay of the witness during the trial
    recovered: bool = True  # clear and arm succeeded afterwards
    note: str = ""  # why they did not

    @property
    def cause(self) -> str:
        """The first reported cause."""
        return self.causes[0] if self.causes else ""


@dataclass(slots=True)
class Report:
    """Results of a whole run."""

    outcomes: list[Outcome] = field(default_factory=list)
    limits: dict[CellName, OutcomeLimits] = field(default_factory=dict)
    untried: list[str] = field(default_factory=list)  # invalid in every attempt
    spoilt: list[str] = field(default_factory=list)  # invalid trials, repeated
    took_s: float = 0.0


def violations(outcome: Outcome, limits: OutcomeLimits) -> list[str]:
    """Return messages for the violated bounds."""
    fastest_m_s, most_m_s = outcome.fastest_m_s, limits.speed_m_s * JUMP_MARGIN
    always: tuple[tuple[bool, str], ...] = (
        (fastest_m_s > most_m_s, f"the flange jumped: {fastest_m_s * 1e3:.0f} mm/s"),
        (outcome.stale > 0, f"{outcome.stale} stale commands were executed"),
    )
    if outcome.continued:  # also the shortest freeze is longer than the deadlines
        rules = (*always, (True, "the cell went on"))
    else:
        rules = (*always, *_rules_of_a_hold(outcome, limits))
    return [text for broken, text in rules if broken]


def _rules_of_a_hold(outcome: Outcome, limits: OutcomeLimits) -> tuple[tuple[bool, str], ...]:
    last_s, still_s = outcome.last_accepted_s or 0.0, outcome.still_s or 0.0
    never_stood = outcome.still_s is None and not outcome.arm_ended
    cause_due = not outcome.case.ends_who_reports
    shows_nothing = bool(outcome.cause or not cause_due) and not outcome.status_shows
    return (
        (last_s > LAST_ACCEPTED_S, f"motion was accepted {last_s * 1e3:.0f} ms after the fault"),
        (never_stood, "the arm did not come to a stand"),
        (still_s > limits.still_s, f"the arm stood only after {still_s * 1e3:.0f} ms"),
        (outcome.moved_m > DRIFT_M, f"it moved {outcome.moved_m * 1e3:.2f} mm without arming"),
        (bool(outcome.provoked), f"{', '.join(outcome.provoked)} accepted without arming"),
        (cause_due and not outcome.cause, "nothing named a cause"),
        (shows_nothing, "forcemesh status did not show it"),
        (not outcome.recovered, outcome.note),
    )


class Journal:
    """Journal file: one line of JSON for each trial, valid or not."""

    def __init__(self, path: Path | None) -> None:
        """Read an existing file; without a path nothing is stored."""
        self._path = path
        self.outcomes: list[Outcome] = []
        self.spoilt: list[str] = []
        known = path.read_text(encoding="utf-8") if path is not None and path.exists() else ""
        for fields in map(json.loads, known.splitlines()):
            if "spoilt" in fields:
                self.spoilt.append(fields["spoilt"])
            else:
                self.outcomes.append(Outcome(**fields | {"case": Case(**fields["case"])}))

    def left(self, cases: Iterable[Case]) -> list[Case]:
        """Return the cases without an outcome."""
        tried = {outcome.case for outcome in self.outcomes}
        return [case for case in cases if case not in tried]

    def tried(self, outcome: Outcome) -> None:
        """Record a valid trial."""
        self._write(asdict(outcome))

    def repeated(self, why: str) -> None:
        """Record an invalid trial."""
        self._write({"spoilt": why})

    def _write(self, fields: dict[str, object]) -> None:
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(fields) + "\n")

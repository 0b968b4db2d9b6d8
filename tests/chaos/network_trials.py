"""Procedure of a trial: approach, apply the fault to a wire, remove it, evaluate the arm."""

import random
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.errors import ForcemeshError
from launch.started_process import ProcessSpec
from sim.robot.trace import VARIABLE as TRACE
from tests.chaos.common_net import CellUnderTest, HarnessError, environment, running_cell
from tests.chaos.network_faults import Ends
from tests.chaos.network_judge import (
    MOVES_M_S,
    GroundTruthTrace,
    TrialBounds,
    TrialObservations,
    TrialVerdict,
    judge,
)
from tests.chaos.witness import STALL_S, Witness, witness

PRESS_N = 10.0
CLEARANCE_M = 0.03  # start height of an approach above the initial height of the flange
TRAVEL_S = 0.05, 0.4  # time of the fault after the start of the approach
SET_OUT_S = 3.0
WATCH_S = 1.5  # after the heal; the arm must be at rest
FRESH_S = 5.0
ATTEMPTS = 4


@dataclass(frozen=True, slots=True)
class NetworkTrial:
    """One fault on one wire. `end` returns its number of effects."""

    wire: str
    fault: str
    begin: Callable[[], None]
    end: Callable[[], int]
    lasts_s: float
    ends: Ends
    bounds: TrialBounds


@contextmanager
def observed_cell(
    cell: CellConfig, path: Path, processes: Sequence[ProcessSpec]
) -> Iterator[tuple[CellUnderTest, GroundTruthTrace, Witness]]:
    """Run a cell with a trace of its arm and a witness during the block."""
    trace = path.parent / "trace.bin"
    with (
        environment(**{TRACE: str(trace)}),
        witness(path.parent) as watch,
        running_cell(cell, path, processes) as under_test,
    ):
        yield under_test, GroundTruthTrace(trace), watch


class Bench:
    """Running cell with the ground truth of its arm and a witness."""

    def __init__(
        self, cell: CellUnderTest, truth: GroundTruthTrace, watch: Witness, rng: random.Random
    ) -> None:
        """Tare, and store the height of the arm."""
        self.cell, self.truth, self.witness, self._rng = cell, truth, watch, rng
        cell.tare()
        self._high_m = cell.height_m() + CLEARANCE_M

    def run(self, trial: NetworkTrial) -> tuple[TrialVerdict, TrialObservations, int]:
        """Run a trial; also return the number of repetitions.

        It is repeated if the machine stalled, and if a random loss hit no packet.
        """
        repeated = 0
        while True:
            verdict, observed = self._once(trial)
            if trial.ends == "either" and not observed.bites and repeated < ATTEMPTS - 1:
                repeated += 1
                continue
            doubtful = verdict.mistakes or (observed.held and trial.ends != "held")
            if not doubtful or observed.stall_s < STALL_S:
                return verdict, observed, repeated
            if repeated == ATTEMPTS - 1:
                stalled = f"the machine stalled in every attempt, {observed.stall_s * 1e3:.0f} ms"
                mistakes = (*verdict.mistakes, stalled) if verdict.mistakes else ()
                return replace(verdict, mistakes=mistakes), observed, repeated
            repeated += 1

    def _once(self, trial: NetworkTrial) -> tuple[TrialVerdict, TrialObservations]:
        self._approach()
        mark = max(0, self.truth.mark() - 20)
        began_ns = time.monotonic_ns()
        trial.begin()
        try:
            time.sleep(trial.lasts_s)
        finally:
            bites = trial.end()
        healed_ns = time.monotonic_ns()
        time.sleep(WATCH_S)
        observed = self._observe(trial, began_ns, healed_ns, bites)
        return judge(observed, *self.truth.speeds(mark), trial.bounds), observed

    def _approach(self) -> None:
        """Approach under force feedback, faster than 2 mm/s, to a random height."""
        why: list[str] = []
        for _ in range(ATTEMPTS):
            try:
                self._set_out()
            except ForcemeshError as error:  # occasional machine stalls
                why.append(str(error))
                continue
            time.sleep(self._rng.uniform(*TRAVEL_S))
            if self.truth.speed_now() > MOVES_M_S and self.cell.state == "ACTIVE":
                return
            why.append(f"it stopped: {self.cell.causes()}")
        raise HarnessError(f"the arm does not keep moving: {'; '.join(why)}")

    def _set_out(self) -> None:
        cell = self.cell
        cell.make_ready()
        cell.move_to(self._high_m, speed_m_s=0.1)
        cell.press(PRESS_N)
        cell.until(lambda: self.truth.speed_now() > MOVES_M_S, "the arm moves", SET_OUT_S)

    def _observe(
        self, trial: NetworkTrial, began_ns: int, healed_ns: int, bites: int
    ) -> TrialObservations:
        """Observe the cell after the heal, once all topics are fresh again."""
        cell = self.cell
        are_fresh = lambda: cell.status is not None and cell.robot is not None  # noqa: E731
        cell.until(are_fresh, "arbiter and robot topics are fresh again", FRESH_S)
        status, robot = cell.status, cell.robot
        if status is None or robot is None:
            raise HarnessError("arbiter or robot topic expired again")
        return TrialObservations(
            began_ns=began_ns,
            healed_ns=healed_ns,
            accepted_ns=None if robot.accepted is None else robot.accepted.at_ns,
            held=not status.operational,
            causes=cell.causes(),
            bites=bites,
            ends=trial.ends,
            stall_s=self.witness.worst_s(began_ns, time.monotonic_ns()),
        )


CABLE = "controller"  # the wire between gateway and controller
MARGIN_S = 0.05  # for real processes, beyond the cell's deadline
RAMP_S = 0.2  # deceleration of the arm, and the filter of its servos
LOOP_S = 0.05  # cycle time of the controller's program
FASTEST_M_S = 0.06  # 50 mm/s limit of the set points, plus the overshoot of a stop
HEAD = ("cell", "wire", "fault", "bites", "outcome", "last command ms", "still ms",
        "fastest mm/s",
        "obeyed after heal", "named cause", "repeated", "")  # fmt: skip


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table."""

    cell: str
    trial: NetworkTrial
    verdict: TrialVerdict
    observed: TrialObservations
    repeated: int

    def cells(self) -> tuple[object, ...]:
        """Return the cells of the row, for the console."""
        verdict, trial = self.verdict, self.trial
        return (
            self.cell, trial.wire, trial.fault, self.observed.bites, verdict.outcome,
            _ms(verdict.last_command_ms), _ms(verdict.still_ms),
            f"{verdict.fastest_m_s * 1e3:.0f}", verdict.stale,
            self.observed.causes or "-", self.repeated, "; ".join(verdict.mistakes) or "ok",
        )  # fmt: skip

    def result(self) -> tuple[str, str, str]:
        """Return cable, fault, and `last command/still` [ms] with the violated bounds."""
        verdict, trial = self.verdict, self.trial
        held = f"{_ms(verdict.last_command_ms)}/{_ms(verdict.still_ms)}"
        words = (held if verdict.outcome == "held" else "on", *verdict.mistakes)
        return f"{self.cell} {trial.wire}", trial.fault, "; ".join(words)


def grid(results: Iterable[tuple[str, str, str]]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of a table: one row per fault, one column per cable."""
    found = {(fault, cable): text for cable, fault, text in results}
    faults, cables = (list(dict.fromkeys(names)) for names in zip(*found, strict=True))
    rows = [[fault, *(found.get((fault, cable), "") for cable in cables)] for fault in faults]
    return ["fault", *cables], rows


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"


def bounds_of(cell: CellConfig, *, is_cable: bool) -> TrialBounds:
    """Return the bounds of a cell; on the controller's cable those of its own watchdog."""
    command_s = cell.stale_after_s(topics.ROBOT_COMMAND) + MARGIN_S
    if not is_cable or cell.gateway is None:
        through_program_s = 0.0 if cell.gateway is None else LOOP_S
        return TrialBounds(command_s, command_s + RAMP_S + through_program_s, FASTEST_M_S)
    watchdog_s = cell.gateway.watchdog_s + LOOP_S
    return TrialBounds(command_s + watchdog_s, watchdog_s + MARGIN_S + RAMP_S, FASTEST_M_S)


def is_selected(trial: NetworkTrial, only: str) -> bool:
    """Return whether a trial is selected: `wire/fault`, `wire`, or `/fault`; empty for all."""
    wire, _, fault = only.partition("/")
    return wire in ("", trial.wire) and fault in ("", trial.fault)


def played(
    name: str,
    cell: CellConfig,
    path: Path,
    *,
    processes: Sequence[ProcessSpec],
    trials: Sequence[NetworkTrial],
    seed: int,
) -> Iterator[Row]:
    """Start a cell and run trials on it."""
    if not trials:
        return
    with observed_cell(cell, path, processes) as observed:
        bench = Bench(*observed, random.Random(seed))
        for trial in trials:
            row = Row(name, trial, *bench.run(trial))
            print(" | ".join(str(word) for word in row.cells()), flush=True)
            yield row

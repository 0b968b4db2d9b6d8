"""Execution of network trials on a cell, and rows of the result table."""

import os
import random
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from common.config.cell import CellConfig
from forcemesh import topics
from launch.started_process import ProcessSpec
from sim.robot.trace import VARIABLE as TRACE
from tests.chaos.common_net import running_cell
from tests.chaos.network_judge import GroundTruthTrace, TrialBounds, TrialObservations, TrialVerdict
from tests.chaos.network_trials import Bench, NetworkTrial
from tests.chaos.witness import witness

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


@contextmanager
def environment(name: str, value: str) -> Iterator[None]:
    """Set an environment variable for processes started in the block."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


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
    trace = path.parent / "trace.bin"
    with ExitStack() as exits:
        exits.enter_context(environment(TRACE, str(trace)))
        watch = exits.enter_context(witness(path.parent))
        under_test = exits.enter_context(running_cell(cell, path, processes))
        bench = Bench(under_test, GroundTruthTrace(trace), watch, random.Random(seed))
        for trial in trials:
            row = Row(name, trial, *bench.run(trial))
            print(" | ".join(str(word) for word in row.cells()), flush=True)
            yield row

"""Execution of cases on real cells; prints each outcome and repeats invalid trials."""

import tempfile
import time
from collections.abc import Iterable
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.messages import Host
from tests.chaos.cases import Case, CellName
from tests.chaos.injector import NoEffectError
from tests.chaos.measure import InvalidTrialError
from tests.chaos.outcome import Journal, OutcomeLimits, Report
from tests.chaos.recorder_client import RecorderClient
from tests.chaos.rig import Rig, chaos_cell
from tests.chaos.scripted_job import NotMovingError, ScriptedJob
from tests.chaos.table import one_line
from tests.chaos.trial import Trials

ATTEMPTS = 4
CONNECT_WITHIN_S = 20.0


def limits_of(cell: CellConfig) -> OutcomeLimits:
    """Return the limits of a cell for the evaluation."""
    return OutcomeLimits(
        command_s=cell.stale_after_s(topics.ROBOT_COMMAND),
        watchdog_s=0.0 if cell.gateway is None else cell.gateway.watchdog_s,
        speed_m_s=cell.limits.speed_m_s,
    )


class CaseRunner:
    """Runs cases; keeps a cell running while consecutive cases use it."""

    def __init__(self, journal: Journal) -> None:
        """Start without a cell; outcomes of the journal are part of the report."""
        self.report = Report(outcomes=list(journal.outcomes), spoilt=list(journal.spoilt))
        for cell in {outcome.case.cell for outcome in journal.outcomes}:
            self.report.limits[cell] = limits_of(chaos_cell(cell))
        self._journal = journal
        self._exits = ExitStack()
        self._trials: Trials | None = None

    def run(self, cases: Iterable[Case]) -> Report:
        """Run all cases in order. Call it in the main thread."""
        started_s = time.monotonic()
        try:
            for cell, group in groupby(cases, key=lambda case: case.cell):
                for case in group:
                    self._try(cell, case)
                self._close()
        finally:
            self._close()
        self.report.took_s = time.monotonic() - started_s
        return self.report

    def _try(self, name: CellName, case: Case) -> None:
        for _ in range(ATTEMPTS):
            try:
                outcome = (self._trials or self._open(name)).run(case)
            except (InvalidTrialError, NotMovingError, NoEffectError) as error:
                self._print(f"{case.cell} {case.name:<32} does not count: {error}")
                self.report.spoilt.append(f"{case.cell} {case.name}: {error}")
                self._journal.repeated(self.report.spoilt[-1])
                if not isinstance(error, InvalidTrialError):
                    self._close()
                continue
            self.report.outcomes.append(outcome)
            self._journal.tried(outcome)
            self._print(one_line(outcome, self.report.limits[name]))
            if not outcome.recovered:
                self._close()
            return
        self._print(f"{case.cell} {case.name:<32} could not be tried")
        self.report.untried.append(case.again)
        self._close()

    def _open(self, name: CellName) -> Trials:
        cell = chaos_cell(name)
        self.report.limits[name] = limits_of(cell)
        folder = Path(self._exits.enter_context(tempfile.TemporaryDirectory(prefix="chaos-")))
        rig = self._exits.enter_context(Rig(cell, folder))
        client = open_bus(cell, topics.CLIENT, patience_s=CONNECT_WITHIN_S)
        client_of_cell = RecorderClient(self._exits.enter_context(client))
        host: Host = "pc" if name == "sim" else "controller"
        self._trials = Trials(rig, client_of_cell, ScriptedJob(client_of_cell, release_host=host))
        return self._trials

    def _close(self) -> None:
        self._exits.close()
        self._trials = None

    def _print(self, line: str) -> None:
        print(line, flush=True)

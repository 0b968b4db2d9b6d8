"""Procedure of one injection, from the moving arm to the evaluation of the trace."""

import time
from contextlib import nullcontext

from cli.status import CellStatus, cell_status
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.faults import FAULTS
from launch.cell_view import CellView
from launch.run_file import read_run
from tests.chaos import injector, memory
from tests.chaos.cases import Case
from tests.chaos.measure import Window, measure
from tests.chaos.outcome import Outcome
from tests.chaos.recorder_client import RecorderClient
from tests.chaos.rig import Rig
from tests.chaos.scripted_job import NotMovingError, ScriptedJob

WATCH_S = 2.0  # observation time for uncommanded motion
STATUS_DELAY_S = 0.5  # from the end of a process to the status query
UP_WITHIN_S = 30.0


class Trials:
    """Runs cases on one running cell."""

    def __init__(self, rig: Rig, recorder: RecorderClient, job: ScriptedJob) -> None:
        """Use a running cell."""
        self._rig, self._recorder, self._job = rig, recorder, job
        self._view = CellView(recorder.bus, rig.cell)

    def run(self, case: Case) -> Outcome:
        """Run a case.

        Raises InvalidTrialError if the machine stalled or the arm was at rest, NotMovingError if
        it did not reach the phase, NoEffectError if the injection had no effect.
        """
        outcome = Outcome(case)
        is_of_memory = case.kind == "memory"
        with memory.filled_group() if is_of_memory else nullcontext() as filled:
            self._job.arm()
            self._job.begin(case.phase, case.random())
            self._recorder.begin()
            window = self._inject(outcome, filled)
        notes = self._recorder.notes
        self._recorder.begin()
        self._recover(outcome)
        measure(outcome, window, self._rig, notes)
        return outcome

    def _recover(self, outcome: Outcome) -> None:
        """Check the recovery: clear, then arm."""
        try:
            self._job.arm()
        except NotMovingError as error:
            outcome.recovered, outcome.note = False, str(error)

    # --- injection --------------------------------------------------------------------------------

    def _inject(self, outcome: Outcome, filled: memory.FilledGroup | None) -> Window:
        case, names = outcome.case, self._names(outcome.case)
        began_ns, fault_ns, thaw_ns = (
            self._freeze(outcome) if case.frozen_s else self._strike(case, filled)
        )
        ended_names = [name for name in names if self._rig.running[name].ended() is not None]
        if ended_names:
            self._rig.note_deaths()
            if case.kind != "restart":
                self._recorder.during(STATUS_DELAY_S)
                outcome.status_shows = self._shows(self._status(), case.role)
            self._rig.start(*ended_names)
            self._until_up(outcome, *ended_names)
            self._recorder.during(WATCH_S if case.kind == "restart" else WATCH_S / 2)
        self._note_causes(outcome)
        if case.kind == "restart":
            self._restart_the_others(names[0], outcome)
        return Window(began_ns, fault_ns, thaw_ns, self._end(outcome))

    def _names(self, case: Case) -> list[str]:
        """Return the target processes, the measured one first."""
        roles = [case.role, case.second_role] if case.second_role else [case.role]
        return [self._rig.name_of(role) for role in roles]

    def _strike(self, case: Case, filled: memory.FilledGroup | None) -> tuple[int, int, int]:
        """End the target processes; return when that began, when the first had ended, and 0."""
        hit = [self._rig.running[name] for name in self._names(case)]
        if filled is not None:
            began_ns, ended_ns = filled.exhaust(hit[0])
        else:
            end = injector.terminate if case.kind == "terminate" else injector.kill
            times_ns = [end(each) for each in hit]
            began_ns = ended_ns = times_ns[0]
        for each in hit:
            injector.prove_ended(each)
        return began_ns, ended_ns, 0

    def _freeze(self, outcome: Outcome) -> tuple[int, int, int]:
        """Freeze processes for a while, optionally end another; return start, start and end."""
        case = outcome.case
        hit = [self._rig.running[name] for name in self._names(case)]
        frozen = hit[:1] if case.kind.startswith("killed") else hit
        frozen_ns = [injector.freeze(each) for each in frozen]
        for each in frozen:
            injector.prove_frozen(each)
        if len(frozen) < len(hit):
            self._recorder.during(case.frozen_s / 2)
            injector.kill(hit[1])
            injector.prove_ended(hit[1])
        left_s = case.frozen_s - (time.monotonic_ns() - frozen_ns[0]) / NS_PER_S
        self._recorder.during(max(left_s, 0.0))
        thawed_ns = [injector.thaw(each) for each in frozen]
        self._recorder.during(WATCH_S)
        return frozen_ns[0], frozen_ns[0], thawed_ns[0]

    def _restart_the_others(self, name: str, outcome: Outcome) -> None:
        """Restart all processes except the arm, whose motion is measured."""
        arm = self._rig.name_of("robot" if self._rig.cell.roles.robot == "sim" else "sensor")
        others = self._rig.others_than(name, arm)
        self._rig.end(*others)
        self._rig.start(*others)
        self._until_up(outcome, *others)
        self._recorder.during(WATCH_S / 2)

    def _until_up(self, outcome: Outcome, *started: str) -> None:
        """Wait for the new processes: messages of the old ones stay fresh for a while."""

        def up() -> bool:
            pids = {self._view.pid(role) for role in topics.ROLES}
            return not self._view.missing() and pids >= {
                self._rig.running[name].pid for name in started
            }

        if not self._recorder.until(up, UP_WITHIN_S):
            outcome.recovered, outcome.note = False, "; ".join(self._view.missing())

    def _note_causes(self, outcome: Outcome) -> None:
        notes, arbiter = self._recorder.notes, self._recorder.arbiter()
        outcome.causes = [code for code in notes.codes if code in FAULTS]
        held = arbiter is None or not arbiter.operational
        outcome.continued = not notes.codes and not held
        if not outcome.status_shows and not outcome.continued:
            outcome.status_shows = self._shows(self._status(), outcome.case.role)

    def _status(self) -> CellStatus:
        """Return the output of `forcemesh status --json`."""
        return cell_status(self._rig.cell, read_run(self._rig.cell.cell))

    def _shows(self, status: CellStatus, role: str) -> bool:
        """Return whether a status names a received cause, or the target process."""
        codes = {trip["code"] for trip in status["trips"]}
        row = next(row for row in status["services"] if row["name"] == role)
        return bool(codes & set(self._recorder.notes.codes)) or bool(row["fault"])

    def _end(self, outcome: Outcome) -> int:
        """Request motion once more, then end the observation; a cell that continued is held."""
        if outcome.continued:
            end_ns = time.monotonic_ns()
            self._job.hold()
            return end_ns
        outcome.provoked = self._job.provoke()
        self._recorder.during(0.2)
        return time.monotonic_ns()

"""Verb `bringup`: walk the ladder of docs/connect-your-kawasaki.md, keep evidence, continue."""

import shlex
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Context, Exit, Option, echo

from cli.context import (
    NOT_WELL,
    OK,
    REFUSED,
    CellOption,
    answers_yes,
    exit_with_error,
    find_cell_file,
    one_line_errors,
)

if TYPE_CHECKING:
    from cli.bringup.judge import Judgement, RunCommand
    from cli.bringup.needs import Situation
    from cli.bringup.steps import BringupStep
    from common.config.evidence import BringupEvidence, LadderRow, StepEvidence

MARKS = {"passed": "✔", "changed": "↻", "failed": "✖", "open": "·"}
ALL_PASSED = "all steps have passed"

Show = Annotated[bool, Option("--status", help="Show the ladder only; exit code 1 if not passed.")]
Again = Annotated[
    str | None, Option("--again", metavar="STEP", help="Repeat a step that has passed.")
]
Yes = Annotated[
    bool, Option("--yes", help="Confirm every question; only in a simulated or emulated cell.")
]


def bringup(
    context: Context,
    *,
    status: Show = False,
    again: Again = None,
    yes: Yes = False,
    cell: CellOption = None,
) -> None:
    """Walk the ladder from a new controller to a recorded press; continue where it stopped.

    docs/connect-your-kawasaki.md describes each step. Every step asks before it begins; what passed
    is kept in the folder of the cell file, and is no longer passed when its inputs change. This is
    not a safety function.
    """
    with one_line_errors():
        path = find_cell_file(cell)
        evidence = _read(path, again)
        if not status:
            _refuse_wrong_cell(path, yes=yes)
            root = context.find_root().command

            def run(words: list[str]) -> None:
                root.main(args=words, prog_name="forcemesh")

            code = Walk(path, run, yes=yes).until_stopped(evidence)
            raise Exit(code)
        rows = show_ladder(path, evidence)
    raise Exit(OK if all(row.state == "passed" for row in rows) else NOT_WELL)


def _read(path: Path, again: str | None) -> "BringupEvidence":
    """Return the evidence with every step of the table in its order; `again` makes one open."""
    from cli.bringup.steps import STEPS
    from common.config.evidence import BringupEvidence, StepEvidence, read_evidence

    names = [step.name for step in STEPS]
    if again is not None and again not in names:
        exit_with_error(f"--again {again}: no such step; there are {', '.join(names)}")
    before = read_evidence(path).steps
    steps = {
        name: StepEvidence() if name == again else before.get(name, StepEvidence())
        for name in names
    }
    return BringupEvidence(steps=steps)


def _refuse_wrong_cell(path: Path, *, yes: bool) -> None:
    from common.config.load import load_cell

    cell = load_cell(path, with_files=False)
    if cell.gateway is None:
        exit_with_error(f"{path} has no section `gateway`: a bring-up is that of a controller")
    if yes and cell.sim is None:
        exit_with_error(
            "--yes: this cell file has no section `sim`, so the arm is real: a person confirms "
            "each step",
            REFUSED,
        )


def show_ladder(path: Path, evidence: "BringupEvidence") -> "list[LadderRow]":
    """Print every step with its state, and what is next; return the rows."""
    from cli.bringup.steps import PAGE
    from common.config.evidence import ladder

    rows = ladder(path, evidence)
    for number, row in enumerate(rows, 1):
        echo(f"{MARKS[row.state]} {number:2} {row.name:10} {row.state:8} {row.detail}".rstrip())
    following = next_step(rows)
    echo(ALL_PASSED if following is None else f"next: {following} ({PAGE})")
    return rows


def next_step(rows: "list[LadderRow]") -> str | None:
    """Return the first step that has not passed, None when all have."""
    return next((row.name for row in rows if row.state != "passed"), None)


class Walk:
    """Walk of one cell along the ladder, up to the first step that does not pass."""

    def __init__(self, path: Path, run: "RunCommand", *, yes: bool) -> None:
        """Prepare; nothing is run."""
        self._path, self._run, self._yes = path, run, yes

    def until_stopped(self, evidence: "BringupEvidence") -> int:
        """Walk on from the first step that has not passed; return the exit code."""
        from cli.bringup.steps import BY_NAME
        from common.config.evidence import ladder, read_evidence, save_evidence

        rows = show_ladder(self._path, evidence)
        save_evidence(self._path, read_evidence(self._path))  # a refusal comes before any motion
        while (name := next_step(rows)) is not None:
            done = self._attempt(BY_NAME[name])
            if done is None:
                return REFUSED
            evidence = evidence.model_copy(update={"steps": {**evidence.steps, name: done}})
            save_evidence(self._path, evidence)
            if done.failed_at is not None:
                echo(f"FAIL {name}: {done.why}")
                return NOT_WELL
            echo(f"PASS {name}")
            rows = ladder(self._path, evidence)
            if next_step(rows) is None:
                echo(ALL_PASSED)
        return OK

    def _attempt(self, step: "BringupStep") -> "StepEvidence | None":
        """Check, ask, run and judge one step; None if it was not confirmed."""
        from cli.bringup.judge import Judgement
        from cli.bringup.needs import situation_of

        found = situation_of(self._path)
        missing = [text for need in step.needs if (text := need(found))]
        if missing:
            return self._evidence(step, Judgement("; ".join(missing)))
        if why := self._speed_problem(step, found):
            return self._evidence(step, Judgement(why))
        if step.commands and not self._may_begin(step):
            echo(f"{step.name}: not confirmed; nothing was run")
            return None
        judgement = self._judged(step)
        if not judgement.why and step.question and not self._confirmed(step):
            judgement = Judgement(f"not confirmed -> {step.remedy}")
        percent = None if found.running is None else found.running.monitor_speed_percent
        if percent is not None:
            from common.config.evidence import MONITOR_SPEED

            judgement = replace(judgement, numbers={**judgement.numbers, MONITOR_SPEED: percent})
        return self._evidence(step, judgement)

    def _evidence(self, step: "BringupStep", judgement: "Judgement") -> "StepEvidence":
        from common.config.evidence import StepEvidence, input_hashes

        now, numbers = datetime.now(UTC).replace(microsecond=0), judgement.numbers
        if judgement.why:
            return StepEvidence(failed_at=now, why=judgement.why, numbers=numbers)
        inputs = input_hashes(self._path, step.inputs)
        return StepEvidence(passed_at=now, inputs=inputs, numbers=numbers)

    def _speed_problem(self, step: "BringupStep", found: "Situation") -> str:
        """Show the monitor speed against the one of robot.delay_s; return why it is not right."""
        from cli.doctor.checks import check_monitor_speed
        from cli.doctor.verb import print_lines
        from common.config.evidence import measured_monitor_speed

        if found.running is None or found.running.monitor_speed_percent is None:
            return ""
        percent = found.running.monitor_speed_percent
        line = check_monitor_speed(percent / 100.0, measured_monitor_speed(self._path))
        print_lines([line])
        if line.result != "FAIL" or not step.at_measured_speed:
            return ""
        return f"monitor speed: {line.found} -> {line.remedy}"

    def _may_begin(self, step: "BringupStep") -> bool:
        """Ask before the commands of a step."""
        for command in step.commands:
            echo(f"  forcemesh {self._filled(command)}")
        text = "the arm will move: is its space free, and a hand at the emergency stop?"
        return self._yes or answers_yes(f"{step.name}: {text if step.moves else 'begin?'}")

    def _confirmed(self, step: "BringupStep") -> bool:
        question = f"{step.name}: {self._filled(step.question)}"
        if self._yes:
            echo(question)
        return self._yes or answers_yes(
            question, f"interrupted: {step.name} is not confirmed; its evidence is unchanged"
        )

    def _judged(self, step: "BringupStep") -> "Judgement":
        from cli.bringup.judge import Judgement, run_command

        outcomes = []
        for command in step.commands:
            outcomes.append(run_command(self._filled(command), self._path, self._run))
            if outcomes[-1].code != OK:
                break
        if not outcomes:
            return Judgement()
        judgement = step.judge(self._path, outcomes)
        if judgement.why and step.remedy:
            return replace(judgement, why=f"{judgement.why} -> {step.remedy}")
        return judgement

    def _filled(self, text: str) -> str:
        """Return a command or question with the values of this cell."""
        from common.config.evidence import named_files
        from common.config.load import load_cell

        gateway = load_cell(self._path, with_files=False).gateway
        values = {name: getattr(gateway, name, "") for name in ("host", "port", "arm")}
        files = {name: shlex.quote(str(file)) for name, file in named_files(self._path).items()}
        yes = " --yes" if self._yes else ""
        return text.format(probe=files["probe"], tuning=files["tuning"], yes=yes, **values)

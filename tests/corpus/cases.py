"""The AS corpus: small programs whose comments state the expected result.

; after: x = 12 +- 0.5      a global at the end: a number, "text", (pose), or undefined
; prints: text              a line; if there is one, all of them, in order
; stops: E0102 main 3       an error that stopped a task or went to ONE: program and step
; refused: P1000            EXECUTE is refused
; mistake: P0120 7          the file does not parse: code and line; all of them
; runs: demo                the program to execute; main by default
; pendant: motors off       before EXECUTE; also: teach, teach lock, types 12
"""

import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from sim.as_language.errors import AsError, AsSyntaxError
from sim.as_language.syntax import ProgramStep
from sim.as_language.values import Joints, Transformation, Value
from sim.controller.machine import Pendant
from sim.controller.tasks import Compiled, Op, Task
from tests.fakes.as_bench import AsBench

FOLDER = Path(__file__).parent / "as"
FILES = sorted(FOLDER.glob("*.as"))
DIRECTIVE = re.compile(r"^; (after|prints|stops|refused|mistake|runs|pendant): (.*)$", re.MULTILINE)
AFTER = re.compile(r"(?P<name>\S+) = (?P<value>.*?)(?: \+- (?P<tolerance>\S+))?")
LONGEST_S = 30.0


@dataclass(slots=True)
class Outcome:
    """Result of a program."""

    mistakes: list[str] = field(default_factory=list)
    refused: str = ""
    stops: list[str] = field(default_factory=list)
    printed: list[str] = field(default_factory=list)
    executed: list[ProgramStep] = field(default_factory=list)
    bench: AsBench | None = None

    def value(self, name: str) -> Value | None:
        """Return a global variable at the end."""
        assert self.bench is not None, "the program never ran"
        value: Value | None = self.bench.value(name)
        return value


def directives(path: Path, word: str) -> list[str]:
    """Return the texts of a directive in the comments of a file."""
    found = DIRECTIVE.findall(path.read_text(encoding="ascii"))
    return [text.rstrip() for name, text in found if name == word]


@cache
def run(path: Path) -> Outcome:
    """Load and execute a file, once for all tests."""
    outcome = Outcome()
    try:
        bench = outcome.bench = AsBench(path.read_text(encoding="ascii"))
    except AsSyntaxError as error:
        outcome.mistakes = [f"{mistake.code} {mistake.where.line}" for mistake in error.mistakes]
        return outcome
    _record(bench, outcome.executed)
    for act in directives(path, "pendant"):
        _at_the_pendant(bench.pendant, act)
    try:
        bench.start(next(iter(directives(path, "runs")), "main"))
    except AsError as error:
        outcome.refused = error.code
        return outcome
    over = bench.advance(LONGEST_S, lambda: not any(_is_running(t) for t in bench.machine.tasks))
    assert over, "it goes on and on"
    outcome.stops = [f"{s.error.code} {s.program} {s.step}" for s in bench.machine.stops]
    outcome.printed = bench.printed
    return outcome


def expected(text: str) -> tuple[str, Value | None, float]:
    """Read `name = value +- tolerance`."""
    match = AFTER.fullmatch(text)
    assert match is not None, text
    value, tolerance = match["value"], float(match["tolerance"] or 0.0)
    if value == "undefined":
        return match["name"], None, tolerance
    if value.startswith('"'):
        return match["name"], value[1:-1], tolerance
    if value.startswith("("):
        numbers = [float(number) for number in value.strip("()").split(",")]
        return match["name"], Transformation(*numbers), tolerance
    return match["name"], float(value), tolerance


def numbers(value: Value | None) -> tuple[float, ...]:
    """Return the numbers of a value, none for a text."""
    if isinstance(value, Transformation | Joints):
        return tuple(value.numbers())
    return (float(value),) if isinstance(value, float | int) else ()


def _record(bench: AsBench, executed: list[ProgramStep]) -> None:
    """Record every step that is executed without an error."""

    def recording(step: ProgramStep, op: Op) -> Op:
        def run_and_note(task: Task) -> int:
            following = op(task)
            executed.append(step)
            return following

        return run_and_note

    def recorded(compiled: Compiled) -> Compiled:
        ops = map(recording, compiled.steps, compiled.ops)
        return compiled._replace(ops=tuple(ops))

    machine = bench.machine
    machine.control.programs = {
        name: recorded(program) for name, program in machine.control.programs.items()
    }


def _at_the_pendant(pendant: Pendant, act: str) -> None:
    if act == "motors off":
        pendant.motor_power(on=False)
    elif act.startswith("types "):
        pendant.type_line(act.removeprefix("types "))
    elif act == "teach":
        pendant.teach()
    else:
        assert act == "teach lock", act
        pendant.teach_lock(on=True)


def _is_running(task: Task) -> bool:
    return task.state in ("running", "held", "ending")

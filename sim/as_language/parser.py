"""Parser for a whole .as or .pg file: programs, data sections, header lines.

`load` and `parse` return a `syntax.SourceFile` or raise `AsSyntaxError` with every mistake;
`examine` returns both the parsed part and the mistakes. Sections specific to a real controller are
skipped and listed. Bytes are Latin-1: one character is one byte.
"""

import re
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from forcemesh.errors import DataError
from sim.as_language import syntax
from sim.as_language.builder import short_name
from sim.as_language.errors import AsError, AsSyntaxError, SyntaxMistake
from sim.as_language.lines import parse_line, parse_parameters
from sim.as_language.syntax import (
    SIGNIFICANT_CHARACTERS,
    Program,
    ProgramStep,
    Remark,
    SkippedSection,
    SourceFile,
    SourcePosition,
    Statement,
)
from sim.as_language.values import single

HEADER = re.compile(r"\.(?P<word>[A-Za-z][A-Za-z0-9_]*)(?P<rest>.*)", re.DOTALL)
PROGRAM = re.compile(
    r"\s*(?P<name>[A-Za-z][\w.]*)\s*(\((?P<parameters>[^)]*)\)?)?(?P<tail>.*)", re.ASCII
)
TAIL = re.compile(r"\s*(@[^#;]*)?(#\s*-?\d+)?\s*(;.*)?", re.DOTALL)
# Data sections of a saved file, and the sigil of their variables.
KINDS = {".REALS": "", ".STRINGS": "$", ".INTEGER": "@", ".TRANS": "", ".JOINTS": "#"}
DATA_ITEM = re.compile(
    r"(?P<kind>[$#@]?)(?P<name>[A-Za-z][\w.]*)\s*(\[(?P<indices>[\d\s,]+)\])?\s*=?\s*(?P<value>.*)",
    re.ASCII,
)
END = re.compile(r"\.END\b", re.IGNORECASE)
# Structures of a program, and the statement that closes each.
OPENS = {
    syntax.If: "IF", syntax.While: "WHILE", syntax.For: "FOR", syntax.CaseStatement: "CASE",
    syntax.Do: "DO",
}  # fmt: skip
CLOSED_BY = {"IF": "END", "WHILE": "END", "FOR": "END", "CASE": "END", "DO": "UNTIL"}


def load(path: Path) -> SourceFile:
    """Parse a file; raise `AsSyntaxError` with every mistake, `DataError` if it cannot be read."""
    return parse(text_of(path), str(path))


def text_of(path: Path) -> str:
    """Return the text of a file; raise `DataError` if it cannot be read."""
    try:
        return path.read_bytes().decode("latin-1")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def parse(text: str, name: str = "text") -> SourceFile:
    """Parse the text of a file; raise `AsSyntaxError` with every mistake."""
    source, mistakes = examine(text, name)
    if mistakes:
        raise AsSyntaxError(mistakes)
    return source


@lru_cache(maxsize=8)
def examine(text: str, name: str = "text") -> tuple[SourceFile, tuple[SyntaxMistake, ...]]:
    """Parse the text of a file; return the parsed part, and every mistake.

    The result is immutable and cached: equal texts share it.
    """
    reader = _Reader(name)
    for number, line in enumerate(re.split(r"\r\n|\n|\r", text), start=1):
        reader.read(line, SourcePosition(name, number))
    return reader.finish()


class _Reader:
    """Line-by-line parser state: current section, programs, mistakes."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.section = ""  # "", ".PROGRAM", a data section, or one that is skipped
        self.program: _ProgramReader | None = None
        self.programs: dict[str, Program] = {}
        self.data: list[syntax.DataValue] = []
        self.skipped: list[SkippedSection] = []
        self.remarks: list[Remark] = []
        self.mistakes: list[SyntaxMistake] = []

    def read(self, line: str, where: SourcePosition) -> None:
        """Parse the next line."""
        stripped = line.strip(" \t\x1a\x00")
        header = HEADER.match(stripped)
        if END.match(stripped):
            self._close()
        elif self.program and not (header and header["word"].upper() == "PROGRAM"):
            self.program.read(line, where)
        elif header is not None:
            self._open(header, where)
        elif self.section in KINDS and stripped and not stripped.startswith(";"):
            try:
                self.data.append(_data_line(self.section, stripped, where))
            except AsError as error:
                self.mistakes.append(SyntaxMistake(where, error.code, error.detail))
        elif not self.section and stripped and not stripped.startswith((";", ".*")):
            text = f"{stripped!a:.60} is outside of any .PROGRAM or data section"
            self.mistakes.append(SyntaxMistake(where, "P0109", text))

    def finish(self) -> tuple[SourceFile, tuple[SyntaxMistake, ...]]:
        """Return the file and its mistakes in the order of the file."""
        self._close_unfinished()
        source = SourceFile(
            self.name, self.programs, tuple(self.data), tuple(self.skipped), tuple(self.remarks)
        )
        return source, tuple(sorted(self.mistakes, key=lambda m: (m.where.line, m.column)))

    def _open(self, header: re.Match[str], where: SourcePosition) -> None:
        self._close_unfinished()
        self.section = f".{header['word'].upper()}"
        if self.section == ".PROGRAM":
            self.program = _ProgramReader(header["rest"], where)
        elif self.section not in KINDS:
            self.skipped.append(SkippedSection(self.section, where))

    def _close_unfinished(self) -> None:
        if self.program is not None:
            text = "the program has no .END"
            self.mistakes.append(SyntaxMistake(self.program.where, "P0140", text))
            self._close()

    def _close(self) -> None:
        self.section = ""
        if self.program is None:
            return
        program = self.program.finish()
        self.mistakes += self.program.mistakes
        self.remarks += self.program.remarks
        if program.name in self.programs:
            first = self.programs[program.name].where
            text = f"program {program.name} is defined twice, first in line {first.line}"
            self.remarks.append(Remark(program.where, text))
        self.programs[program.name] = program
        self.program = None


# --- programs -------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Open:
    """Open structure: its step, and the inner steps that need the index of its end."""

    kind: str
    at: int
    inner: list[int] = field(default_factory=list)


class _ProgramReader:
    """Parser of one program: numbers its steps, collects labels, and resolves jump targets."""

    def __init__(self, header: str, where: SourcePosition) -> None:
        self.where = where
        self.mistakes: list[SyntaxMistake] = []
        self.remarks: list[Remark] = []
        self.steps: list[ProgramStep] = []
        self.labels: dict[str, int] = {}
        self.name = ""
        self.parameters: tuple[syntax.Variable, ...] = ()
        self._opened: list[_Open] = []
        self._misplaced: list[SyntaxMistake] = []
        try:
            name, self.parameters = _header(header)
            self.name = short_name(name)
            if len(name) > SIGNIFICANT_CHARACTERS:
                text = f"only the first {SIGNIFICANT_CHARACTERS} characters of {name} are used"
                self.remarks.append(Remark(where, text))
        except AsError as error:
            self.mistakes.append(SyntaxMistake(where, error.code, error.detail))

    def read(self, line: str, where: SourcePosition) -> None:
        """Parse the next line; blank lines are not steps."""
        text, at = line.strip(), len(self.steps)
        if not text:
            return
        try:
            parsed = parse_line(line)
        except AsError as error:
            self.mistakes.append(SyntaxMistake(where, error.code, error.detail, error.column))
            return
        label, statement = parsed.label, parsed.statement or syntax.Comment()
        if label in self.labels:
            first = self.steps[self.labels[label]].where.line
            reason = f"label {label} is already defined in line {first}"
            self.mistakes.append(SyntaxMistake(where, "P0146", reason))
        elif label is not None:
            self.labels[label] = at
        self.steps.append(ProgramStep(at + 1, statement, where, text, label))
        self._link(at, statement)

    def finish(self) -> Program:
        """Return the program, with the targets of GOTO."""
        for left in self._opened:
            code = "P0144" if left.kind == "DO" else "P0140"
            self._misplace(left.at, code, f"{left.kind} has no {CLOSED_BY[left.kind]}")
        for at, step in enumerate(self.steps):
            if isinstance(step.statement, syntax.Goto):
                target = self.labels.get(step.statement.label, syntax.UNRESOLVED)
                self._resolve(at, target=target)
        if not self.mistakes:  # an invalid line may be the IF that END closes
            self.mistakes += self._misplaced
        return Program(self.name, self.parameters, tuple(self.steps), self.where, self.labels)

    # --- jump targets -----------------------------------------------------------------------------

    def _link(self, at: int, statement: Statement) -> None:
        """Open or close a structure; the targets inside of it are resolved at its end."""
        kind = OPENS.get(type(statement))
        last = self._opened[-1].kind if self._opened else ""
        match statement:
            case _ if kind is not None:
                self._opened.append(_Open(kind, at))
            case syntax.Else() if last != "IF":
                self._misplace(at, "P0142", "ELSE must be between IF ... THEN and END")
            case syntax.Value() | syntax.Any() if last != "CASE":
                self._misplace(at, "P0145", "VALUE and ANY must be between CASE and END")
            case syntax.Else() | syntax.Value() | syntax.Any():
                opened = self._opened[-1]
                opened.inner.append(at)
                if last == "IF" and len(opened.inner) > 1:
                    text = f"the IF of step {opened.at + 1} already has an ELSE"
                    self._misplace(at, "P0142", text)
            case syntax.Until() if last != "DO":
                self._misplace(at, "P0143", f"UNTIL closes DO{self._instead()}")
            case syntax.Until():
                self._resolve(at, false_at=self._opened.pop().at)
            case syntax.End() if last in ("", "DO"):
                text = f"END closes IF, WHILE, FOR or CASE{self._instead()}"
                self._misplace(at, "P0141", text)
            case syntax.End():
                self._end(at, self._opened.pop())

    def _end(self, at: int, opened: _Open) -> None:
        self._resolve(at, of=opened.kind, start_at=opened.at)
        for inner in opened.inner:
            self._resolve(inner, end_at=at)
        if opened.kind == "IF":
            self._resolve(opened.at, false_at=opened.inner[0] + 1 if opened.inner else at)
        elif opened.kind != "CASE":
            self._resolve(opened.at, false_at=at + 1)
        else:
            branches, default_at = [], at
            for inner in opened.inner:
                statement = self.steps[inner].statement
                if isinstance(statement, syntax.Value):
                    branches.append(syntax.Branch(statement.values, inner + 1))
                else:
                    default_at = inner + 1
            self._resolve(opened.at, branches=tuple(branches), default_at=default_at)

    def _resolve(self, at: int, **targets: Any) -> None:
        step = self.steps[at]
        statement: Any = step.statement
        self.steps[at] = replace(step, statement=replace(statement, **targets))

    def _misplace(self, at: int, code: str, text: str) -> None:
        self._misplaced.append(SyntaxMistake(self.steps[at].where, code, text))

    def _instead(self) -> str:
        if not self._opened:
            return "; none is open here"
        last = self._opened[-1]
        return (
            f"; the {last.kind} of step {last.at + 1} is open and must first be closed by"
            f" {CLOSED_BY[last.kind]}"
        )


def _header(rest: str) -> tuple[str, tuple[syntax.Variable, ...]]:
    """Return name and parameters of `.PROGRAM name(parameters) @date #number ;comment`."""
    match = PROGRAM.fullmatch(rest.strip())
    if match is None:
        raise AsError("P0117", f".PROGRAM is followed by a name; found {rest.strip()!a:.60}")
    if match["parameters"] is not None and ")" not in rest:
        raise AsError("P0120", "the list of parameters is not closed by ')'")
    if not TAIL.fullmatch(match["tail"]):
        text = "expected @date, #number or ;comment after the parameters"
        raise AsError("P0108", f"{text}; found {match['tail']!a:.60}")
    return match["name"], parse_parameters(match["parameters"] or "")


# --- data -----------------------------------------------------------------------------------------


def _data_line(section: str, line: str, where: SourcePosition) -> syntax.DataValue:
    """Return the value on one line of a data section; raise `AsError`."""
    match = DATA_ITEM.match(line.strip())
    if match is None:
        raise AsError("P0108", f"{section}: expected a name and its value; found {line!a:.60}")
    kind = KINDS[section]
    if match["kind"] not in ("", kind):
        raise AsError("P0118", f"{section} holds names with {kind!r}, found {match['kind']!r}")
    indices = tuple(syntax.Number(float(n)) for n in (match["indices"] or "").split(",") if n)
    variable = syntax.Variable(kind, short_name(match["name"]), indices=indices)
    return syntax.DataValue(variable, _value(section, match["value"].strip()), where)


def _value(section: str, spelled: str) -> float | str | tuple[float, ...]:
    if section == ".STRINGS":
        if len(spelled) < 2 or spelled[0] != '"' or spelled[-1] != '"':
            raise AsError("P0108", f"expected a quoted string; found {spelled!a:.60}")
        return spelled[1:-1]
    try:
        numbers = tuple(float(word) for word in spelled.replace(",", " ").split())
        if section == ".INTEGER":
            return float(int(numbers[0]))
        rounded = tuple(single(number) for number in numbers)
    except (ValueError, IndexError, OverflowError, AsError):
        raise AsError("P0100", f"{section}: expected numbers; found {spelled!a:.60}") from None
    if section == ".REALS":
        if len(rounded) != 1:
            raise AsError("P0100", f"expected one number; found {spelled!a:.60}")
        return rounded[0]
    if len(rounded) < 6:
        raise AsError("P0100", f"expected six numbers for a pose; found {len(rounded)}")
    return rounded

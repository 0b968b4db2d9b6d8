"""Parser for a whole .as or .pg file: programs, data sections, header lines.

`load` and `parse` return a `syntax.SourceFile` or raise `AsSyntaxError` with every mistake;
`examine` returns both the parsed part and the mistakes. Sections specific to a real controller are
skipped and listed. Bytes are Latin-1: one character is one byte.
"""

import re
from functools import lru_cache
from pathlib import Path

from forcemesh.errors import DataError
from sim.as_language import syntax
from sim.as_language.builder import short_name
from sim.as_language.errors import AsError, AsSyntaxError, SyntaxMistake
from sim.as_language.lines import LineError, parse_line, parse_parameters
from sim.as_language.structure import Linker
from sim.as_language.syntax import (
    SIGNIFICANT_CHARACTERS,
    Position,
    Program,
    ProgramStep,
    Remark,
    SkippedSection,
    SourceFile,
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


def load(path: Path) -> SourceFile:
    """Parse a file; raise `AsSyntaxError` with every mistake, `DataError` if it cannot be read."""
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    return parse(text, str(path))


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
        reader.read(line, Position(name, number))
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

    def read(self, line: str, where: Position) -> None:
        """Parse the next line."""
        stripped = line.strip(" \t\x1a\x00")
        header = HEADER.match(stripped)
        if END.match(stripped):
            self._close()
        elif self.program is not None:
            if header and header["word"].upper() == "PROGRAM":
                self._add_error(self.program.where, "P0140", "the program has no .END")
                self._close()
                self._open(header, where)
            else:
                self.program.read(line, where)
        elif header is not None:
            self._open(header, where)
        elif self.section in KINDS and stripped and not stripped.startswith(";"):
            self._data(stripped, where)
        elif not self.section and stripped and not stripped.startswith((";", ".*")):
            text = f"{stripped!a:.60} is outside of any .PROGRAM or data section"
            self._add_error(where, "P0109", text)

    def finish(self) -> tuple[SourceFile, tuple[SyntaxMistake, ...]]:
        """Return the file and its mistakes in the order of the file."""
        if self.program is not None:
            self._add_error(self.program.where, "P0140", "the program has no .END")
            self._close()
        source = SourceFile(
            self.name, self.programs, tuple(self.data), tuple(self.skipped), tuple(self.remarks)
        )
        return source, tuple(sorted(self.mistakes, key=lambda m: (m.where.line, m.column)))

    def _open(self, header: re.Match[str], where: Position) -> None:
        self.section = f".{header['word'].upper()}"
        if self.section == ".PROGRAM":
            self.program = _ProgramReader(header["rest"], where)
        elif self.section not in KINDS:
            self.skipped.append(SkippedSection(self.section, where))

    def _close(self) -> None:
        if self.program is None:
            self.section = ""
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
        self.section = ""

    def _data(self, line: str, where: Position) -> None:
        try:
            self.data.append(_data_line(self.section, line, where))
        except LineError as error:
            self._add_error(where, error.code, error.text)

    def _add_error(self, where: Position, code: str, text: str) -> None:
        self.mistakes.append(SyntaxMistake(where, code, text))


class _ProgramReader:
    """Parser of one program: numbers its steps and collects its labels."""

    def __init__(self, header: str, where: Position) -> None:
        self.where = where
        self.mistakes: list[SyntaxMistake] = []
        self.remarks: list[Remark] = []
        self.steps: list[ProgramStep] = []
        self.labels: dict[str, int] = {}
        self.name = ""
        self.parameters: tuple[syntax.Variable, ...] = ()
        try:
            name, self.parameters = _header(header)
            self.name = short_name(name)
            if len(name) > SIGNIFICANT_CHARACTERS:
                text = f"only the first {SIGNIFICANT_CHARACTERS} characters of {name} are used"
                self.remarks.append(Remark(where, text))
        except LineError as error:
            self.mistakes.append(SyntaxMistake(where, error.code, error.text))

    def read(self, line: str, where: Position) -> None:
        """Parse the next line; blank lines are not steps."""
        text = line.strip()
        if not text:
            return
        try:
            parsed = parse_line(line)
        except LineError as error:
            self.mistakes.append(SyntaxMistake(where, error.code, error.text, error.column))
            return
        if parsed.label is not None:
            self._label(parsed.label, where)
        number = len(self.steps) + 1
        statement = parsed.statement or syntax.Comment()
        self.steps.append(ProgramStep(number, statement, where, text, parsed.label))

    def finish(self) -> Program:
        """Link the steps and return the program."""
        linker = Linker(self.steps, self.labels)
        steps = linker.link()
        if not self.mistakes:  # an invalid line may be the IF that END closes
            self.mistakes += linker.mistakes
        return Program(self.name, self.parameters, steps, self.where, self.labels)

    def _label(self, label: str, where: Position) -> None:
        if label in self.labels:
            first = self.steps[self.labels[label]].where.line
            text = f"label {label} is already defined in line {first}"
            self.mistakes.append(SyntaxMistake(where, "P0146", text))
        self.labels.setdefault(label, len(self.steps))


def _header(rest: str) -> tuple[str, tuple[syntax.Variable, ...]]:
    """Return name and parameters of `.PROGRAM name(parameters) @date #number ;comment`."""
    match = PROGRAM.fullmatch(rest.strip())
    if match is None:
        raise LineError("P0117", f".PROGRAM is followed by a name; found {rest.strip()!a:.60}")
    if match["parameters"] is not None and ")" not in rest:
        raise LineError("P0120", "the list of parameters is not closed by ')'")
    if not TAIL.fullmatch(match["tail"]):
        text = (
            f"expected @date, #number or ;comment after the parameters; found {match['tail']!a:.60}"
        )
        raise LineError("P0108", text)
    return match["name"], parse_parameters(match["parameters"] or "")


def _data_line(section: str, line: str, where: Position) -> syntax.DataValue:
    """Return the value on one line of a data section; raise `LineError`."""
    match = DATA_ITEM.match(line.strip())
    if match is None:
        raise LineError("P0108", f"{section}: expected a name and its value; found {line!a:.60}")
    kind = KINDS[section]
    if match["kind"] not in ("", kind):
        raise LineError("P0118", f"{section} holds names with {kind!r}, found {match['kind']!r}")
    indices = tuple(syntax.Number(float(n)) for n in (match["indices"] or "").split(",") if n)
    variable = syntax.Variable(kind, short_name(match["name"]), indices=indices)
    return syntax.DataValue(variable, _value(section, match["value"].strip()), where)


def _value(section: str, spelled: str) -> float | str | tuple[float, ...]:
    if section == ".STRINGS":
        if len(spelled) < 2 or spelled[0] != '"' or spelled[-1] != '"':
            raise LineError("P0108", f"expected a quoted string; found {spelled!a:.60}")
        return spelled[1:-1]
    try:
        numbers = tuple(float(word) for word in spelled.replace(",", " ").split())
        if section == ".INTEGER":
            return float(int(numbers[0]))
        rounded = tuple(single(number) for number in numbers)
    except (ValueError, IndexError, OverflowError, AsError):
        raise LineError("P0100", f"{section}: expected numbers; found {spelled!a:.60}") from None
    if section == ".REALS":
        if len(rounded) != 1:
            raise LineError("P0100", f"expected one number; found {spelled!a:.60}")
        return rounded[0]
    if len(rounded) < 6:
        raise LineError("P0100", f"expected six numbers for a pose; found {len(rounded)}")
    return rounded

"""Syntax tree of an AS source file. Values only, no execution.

    SourceFile                 one .as or .pg file
      Program                  name, parameters, labels and a FLAT tuple of steps
        Step                   number (from 1), label, source line and text, one Statement
      DataValue                one line of .REALS, .STRINGS, .INTEGER, .TRANS or .JOINTS

Statements are flat, not nested. IF, WHILE, FOR, DO and CASE are resolved into **indices into
`Program.steps`** when the file is loaded, so GOTO may enter and leave a structure, and an error
names program and step as the controller does. Every field named `after_...` or `..._at` is such an
index (0-based; `len(steps)` means: end of the program). An `Unresolved` target is -1. Comment
lines are steps (`Comment`), as in the controller's own listing; blank lines are not.

Control flow per statement, where it differs from continuing with the next step:

    If(condition, false_at)    false: jump to false_at (after its ELSE, or to its END)
    Else(end_at)               reached from above: jump to end_at
    While(condition, after_at) false: jump to after_at
    For(...)                   see `For`
    Until(condition, do_at)    false: jump to do_at
    Case(selector, branches, default_at)   first branch with an equal value, else default_at
    Value, Any                 reached from above: jump to end_at
    End(of, start_at)          of "WHILE"/"FOR": jump to start_at; of "IF"/"CASE": no effect
    Goto(label, target, condition)         target -1: E0101

Names are stored in lower case and cut to 15 characters, keywords and functions in upper case and
in full. A variable's `kind` is "" (real or transformation), "$", "#" or "@".
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from sim.controller.syntax_expressions import (
    Binary,
    Expression,
    Format,
    FunctionCall,
    JointLiteral,
    Number,
    Reference,
    Text,
    Unary,
    Variable,
    Word,
)
from sim.controller.syntax_statements import (
    UNRESOLVED,
    Any,
    Assign,
    Branch,
    CallStatement,
    CaseStatement,
    Comment,
    Decompose,
    Do,
    Else,
    End,
    For,
    Goto,
    Here,
    If,
    Instruction,
    PointStatement,
    Print,
    Return,
    Scall,
    Statement,
    Until,
    Value,
    While,
)

__all__ = [
    "SIGNIFICANT_CHARACTERS",
    "UNRESOLVED",
    "Any",
    "Assign",
    "Binary",
    "Branch",
    "CallStatement",
    "CaseStatement",
    "Comment",
    "DataValue",
    "Decompose",
    "Do",
    "Else",
    "End",
    "Expression",
    "For",
    "Format",
    "FunctionCall",
    "Goto",
    "Here",
    "If",
    "Instruction",
    "JointLiteral",
    "Number",
    "PointStatement",
    "Position",
    "Print",
    "Program",
    "ProgramStep",
    "Reference",
    "Remark",
    "Return",
    "Scall",
    "SkippedSection",
    "SourceFile",
    "Statement",
    "Text",
    "Unary",
    "Until",
    "Value",
    "Variable",
    "While",
    "Word",
]

SIGNIFICANT_CHARACTERS = 15


@dataclass(frozen=True, slots=True)
class Position:
    """Position in a file: file and line (from 1)."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@dataclass(frozen=True, slots=True)
class ProgramStep:
    """One step of a program; `number` counts from 1, as in the controller's messages."""

    number: int
    statement: Statement
    where: Position
    text: str = ""
    label: str | None = None


@dataclass(frozen=True, slots=True)
class Program:
    """A program; `labels` maps a label ("10", "accept") to the index of its step."""

    name: str
    parameters: tuple[Variable, ...]
    steps: tuple[ProgramStep, ...]
    where: Position
    labels: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DataValue:
    """One line of a data section; `variable` may hold Number indices.

    `value` is one real, one string, or the numbers of a pose (.TRANS, .JOINTS; at least six).
    """

    variable: Variable
    value: float | str | tuple[float, ...]
    where: Position


@dataclass(frozen=True, slots=True)
class SkippedSection:
    """A skipped section: its name (".ROBOTDATA1") and position."""

    name: str
    where: Position


@dataclass(frozen=True, slots=True)
class Remark:
    """A construct that the parser accepted with a warning."""

    where: Position
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class SourceFile:
    """A whole file: programs by name in file order, data, skipped sections.

    The parser returns the same object for the same text; compiled programs are cached by it.
    """

    name: str
    programs: Mapping[str, Program]
    data: tuple[DataValue, ...] = ()
    skipped: tuple[SkippedSection, ...] = ()
    remarks: tuple[Remark, ...] = ()

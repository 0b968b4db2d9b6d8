"""Syntax tree of an AS source file. Values only, no execution.

    SourceFile                 one .as or .pg file
      Program                  name, parameters, labels and a FLAT tuple of steps
        Step                   number (from 1), label, source line and text, one Statement
      DataValue                one line of .REALS, .STRINGS, .INTEGER, .TRANS or .JOINTS

Statements are flat, not nested. IF, WHILE, FOR, DO and CASE are resolved into **indices into
`Program.steps`** when the file is loaded, so GOTO may enter and leave a structure, and an error
names program and step as the controller does. Every field named `..._at` is such an
index (0-based; `len(steps)` means: end of the program). An `Unresolved` target is -1. Comment
lines are steps (`Comment`), as in the controller's own listing; blank lines are not.

Control flow per statement, where it differs from continuing with the next step:

    If(condition, false_at)    false: jump to false_at (after its ELSE, or to its END)
    Else(end_at)               reached from above: jump to end_at
    While(condition, false_at) false: jump to false_at, after its END
    For(...)                   see `For`
    Until(condition, false_at) false: jump to false_at, its DO
    Case(selector, branches, default_at)   first branch with an equal value, else default_at
    Value, Any                 reached from above: jump to end_at
    End(of, start_at)          of "WHILE"/"FOR": jump to start_at; of "IF"/"CASE": no effect
    Goto(label, target, condition)         target -1: E0101

Names are stored in lower case and cut to 15 characters, keywords and functions in upper case and
in full. A variable's `kind` is "" (real or transformation), "$", "#" or "@".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import dataclass_transform

import msgspec

UNRESOLVED = -1
SIGNIFICANT_CHARACTERS = 15


@dataclass_transform(frozen_default=True, field_specifiers=(msgspec.field,))
class Node(msgspec.Struct, frozen=True):
    """Part of a syntax tree: a value, compared by its fields."""

    def parts(self) -> tuple[object, ...]:
        """Return the values of the fields."""
        return msgspec.structs.astuple(self)


# --- expressions ----------------------------------------------------------------------------------


class Number(Node):
    """A real: 8.5E3, ^B101, ^HC1, 'A, TRUE, OFF. Already rounded to single precision."""

    value: float


class Text(Node):
    """A string literal, without its quotes. One character is one byte (Latin-1)."""

    value: str


class Variable(Node):
    """A variable or one array element: `x`, `.x`, `$s[1]`, `.#j`, `@n[1,2]`.

    `whole` is True for `a[]`, the array itself (an argument of CALL or a parameter).
    """

    kind: str
    name: str
    local: bool = False
    indices: tuple[Expression, ...] = ()
    whole: bool = False

    @property
    def spelling(self) -> str:
        """Return the name as AS writes it, without indices: `.$s`."""
        return f"{'.' if self.local else ''}{self.kind}{self.name}"


class Unary(Node):
    """An operator before its operand: "-", "NOT" or "COM"."""

    operator: str
    operand: Expression


class Binary(Node):
    """An operator between its operands.

    ^ * / MOD + - < <= == <> >= > BAND BOR BXOR AND OR XOR; `=<`, `=>` and `!=` are stored as
    `<=`, `>=` and `<>`. "+" and "-" of transformations compose them.
    """

    operator: str
    left: Expression
    right: Expression


class FunctionCall(Node):
    """A function with its arguments, `None` if one is omitted: TRANS(1,,3), PI, $LEFT($s,1).

    SHIFT(p BY x,y,z) holds (p, x, y, z). SWITCH(CP) and the EXIST functions hold `Word`s.
    """

    name: str
    arguments: tuple[Expression | None, ...] = ()


class JointLiteral(Node):
    """Joint values written out: #[j1,...,j6]."""

    values: tuple[Expression, ...]


class Format(Node):
    """A format of PRINT, TYPE or $ENCODE: /F5.2 is ("F", 5, 2), /S is ("S", None, None)."""

    code: str
    width: int | None = None
    decimals: int | None = None


class Word(Node):
    """A bare name that is not a variable: a program, a switch, a keyword. Lower case."""

    name: str


class Reference(Node):
    """`&p` or `.&p[,]`: an argument of CALL marked as a transformation."""

    variable: Variable


Expression = (
    Number
    | Text
    | Variable
    | Unary
    | Binary
    | FunctionCall
    | JointLiteral
    | Format
    | Word
    | Reference
)


# --- statements -----------------------------------------------------------------------------------


class Statement(Node):
    """One statement of a program."""


class Comment(Statement):
    """A comment line: a step without effect."""


class Assign(Statement):
    """`x = 1`, `$s = "a"`, `@n[2] = 3`. Not `TIMER(1)=0`: an Instruction."""

    target: Variable
    value: Expression


class PointStatement(Statement):
    """`POINT p = expr`, `POINT #j = trans, #configuration`, `POINT/X p = q`.

    `POINT a+b = c` defines the rightmost, relative to the rest. `part` is "" or one of X Y Z OAT O
    A T (also EXT and 7 to 18: not executed).
    """

    target: Variable
    value: Expression
    part: str = ""
    configuration: Expression | None = None
    relative_to: Expression | None = None


class Here(Statement):
    """`HERE p`, `HERE #p`, `HERE a+b` (defines the rightmost, relative to the rest)."""

    target: Variable
    relative_to: Expression | None = None


class Decompose(Statement):
    """`DECOMPOSE arr[k] = pose`: six reals from element k on."""

    target: Variable
    value: Expression


class If(Statement):
    """`IF condition THEN`."""

    condition: Expression
    false_at: int = UNRESOLVED


class Else(Statement):
    """`ELSE`: jumps to its END when reached from above."""

    end_at: int = UNRESOLVED


class While(Statement):
    """`WHILE condition DO`; `false_at` is the step after its END."""

    condition: Expression
    false_at: int = UNRESOLVED


class Do(Statement):
    """`DO`: no effect; jump target of its UNTIL."""


class Until(Statement):
    """`UNTIL condition`: false jumps to its DO at `false_at`."""

    condition: Expression
    false_at: int = UNRESOLVED


class For(Statement):
    """`FOR v = start TO stop STEP step`.

    Start is assigned, stop and step are evaluated once; the test precedes the body, END adds the
    step and tests again. Beyond stop: jump to `false_at` (v keeps its value).
    """

    variable: Variable
    start: Expression
    stop: Expression
    step: Expression = Number(1.0)
    false_at: int = UNRESOLVED


class Branch(Node):
    """One VALUE or SVALUE of a CASE: its values and the step after it."""

    values: tuple[Expression, ...]
    body_at: int


class CaseStatement(Statement):
    """`CASE x OF` or (`text` True) `SCASE $x OF`; `default_at` is after ANY, or at the END."""

    selector: Expression
    text: bool = False
    branches: tuple[Branch, ...] = ()
    default_at: int = UNRESOLVED


class Value(Statement):
    """`VALUE 1,2:` or `SVALUE "a":`: jumps to the END when reached from above."""

    values: tuple[Expression, ...]
    end_at: int = UNRESOLVED


class Any(Statement):
    """`ANY :`, the default branch."""

    end_at: int = UNRESOLVED


class End(Statement):
    """`END` of an IF, WHILE, FOR or CASE; `start_at` is the step that opened it."""

    of: str = ""
    start_at: int = UNRESOLVED


class Goto(Statement):
    """`GOTO label`, `GOTO label IF condition`, `IF condition GOTO label`."""

    label: str
    condition: Expression | None = None
    target: int = UNRESOLVED


class CallStatement(Statement):
    """`CALL prog(a, &b, 1+2)`. A Variable or Reference is passed by reference."""

    program: str
    arguments: tuple[Expression | None, ...] = ()


class Scall(Statement):
    """`SCALL $name, result`: the name is in a string; result gets the error code."""

    program: Expression
    result: Variable | None = None


class Return(Statement):
    """`RETURN`."""


class Print(Statement):
    """`PRINT 2: items` or `TYPE items`; items are expressions and `Format`s."""

    name: str
    items: tuple[Expression | None, ...] = ()
    device: Expression | None = None


class Instruction(Statement):
    """Any other instruction: full upper-case name, arguments in order, words in order.

    SPEED 30 MM/S ALWAYS   ("SPEED", (30,), ("MM/S", "ALWAYS"))
    PCEXECUTE 2: p,-1      ("PCEXECUTE", (2, Word p, -1)); without a number: 1 (Number)
    PCABORT 2:, PCEND 2:   ("PCABORT", (2,))
    MC EXECUTE p,-1        ("MC EXECUTE", (Word p, -1)); MC SPEED 1: 5 has (5,) and ("1:",)
    TIMER 1 = 0, TIMER(1)=0  ("TIMER", (1, 0))
    CP ON                  ("SWITCH", (Word cp,), ("ON",)); RTC_SW 1: ON has ("1:", "ON")
    JOINT SPEED9 ...       ("JOINT", (Text,)): a block step of the pendant, its text unparsed
    POINT p                ("POINT", (p,)): the monitor command, which prompts for the numbers
    XMOVE/ERR p TILL s     ("XMOVE", (p, s), ("/ERR", "TILL"))
    ON s CALL p, 10        ("ON", (s, Word p, 10), ("CALL",)); with GOTO the label is a Word
    ONE p, IGNORE s        ("ONE", (Word p,)), ("IGNORE", (s,))
    BREAK, LEFTY, STOP     (name, ())

    `unknown` is True if the first word is not a known AS instruction; if the rest is not an
    argument list either, it is stored as raw text in the only argument, a Text.
    """

    name: str
    arguments: tuple[Expression | None, ...] = ()
    modifiers: tuple[str, ...] = ()
    unknown: bool = False


# --- files ----------------------------------------------------------------------------------------


class SourcePosition(Node):
    """Position in the source: file and line (from 1)."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


class ProgramStep(Node):
    """One step of a program; `number` counts from 1, as in the controller's messages."""

    number: int
    statement: Statement
    where: SourcePosition
    text: str = ""
    label: str | None = None


class Program(Node):
    """A program; `labels` maps a label ("10", "accept") to the index of its step."""

    name: str
    parameters: tuple[Variable, ...]
    steps: tuple[ProgramStep, ...]
    where: SourcePosition
    labels: Mapping[str, int] = msgspec.field(default_factory=dict)


class DataValue(Node):
    """One line of a data section; `variable` may hold Number indices.

    `value` is one real, one string, or the numbers of a pose (.TRANS, .JOINTS; at least six).
    """

    variable: Variable
    value: float | str | tuple[float, ...]
    where: SourcePosition


class SkippedSection(Node):
    """A skipped section: its name (".ROBOTDATA1") and position."""

    name: str
    where: SourcePosition


class Remark(Node):
    """A construct that the parser accepted with a warning."""

    where: SourcePosition
    text: str


class SourceFile(Node, eq=False):
    """A whole file: programs by name in file order, data, skipped sections.

    The parser returns the same object for the same text; compiled programs are cached by it.
    """

    name: str
    programs: Mapping[str, Program]
    data: tuple[DataValue, ...] = ()
    skipped: tuple[SkippedSection, ...] = ()
    remarks: tuple[Remark, ...] = ()

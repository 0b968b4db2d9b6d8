"""Statement nodes of the syntax tree, one per step: values only. `syntax` describes linking."""

from dataclasses import dataclass

from sim.controller.syntax_expressions import Expression, Variable

UNRESOLVED = -1


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment line: a step without effect."""


@dataclass(frozen=True, slots=True)
class Assign:
    """`x = 1`, `$s = "a"`, `@n[2] = 3`. Not `TIMER(1)=0`: an Instruction."""

    target: Variable
    value: Expression


@dataclass(frozen=True, slots=True)
class PointStatement:
    """`POINT p = expr`, `POINT #j = trans, #configuration`, `POINT/X p = q`.

    `part` is "" or one of X Y Z OAT O A T (also EXT and similar: not executed).
    """

    target: Variable
    value: Expression
    part: str = ""
    configuration: Expression | None = None


@dataclass(frozen=True, slots=True)
class Here:
    """`HERE p`, `HERE #p`, `HERE a+b` (defines the rightmost, relative to the rest)."""

    target: Variable
    relative_to: Expression | None = None


@dataclass(frozen=True, slots=True)
class Decompose:
    """`DECOMPOSE arr[k] = pose`: six reals from element k on."""

    target: Variable
    value: Expression


@dataclass(frozen=True, slots=True)
class If:
    """`IF condition THEN`."""

    condition: Expression
    false_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class Else:
    """`ELSE`: jumps to its END when reached from above."""

    end_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class While:
    """`WHILE condition DO`; `after_at` is the step after its END."""

    condition: Expression
    after_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class Do:
    """`DO`: no effect; jump target of its UNTIL."""


@dataclass(frozen=True, slots=True)
class Until:
    """`UNTIL condition`: false jumps to `do_at`."""

    condition: Expression
    do_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class For:
    """`FOR v = start TO stop STEP step`.

    Start is assigned, stop and step are evaluated once; the test precedes the body, END adds the
    step and tests again. Beyond stop: jump to `after_at` (v keeps its value).
    """

    variable: Variable
    start: Expression
    stop: Expression
    step: Expression
    after_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class Branch:
    """One VALUE or SVALUE of a CASE: its values and the step after it."""

    values: tuple[Expression, ...]
    body_at: int


@dataclass(frozen=True, slots=True)
class CaseStatement:
    """`CASE x OF` or (`text` True) `SCASE $x OF`; `default_at` is after ANY, or at the END."""

    selector: Expression
    text: bool = False
    branches: tuple[Branch, ...] = ()
    default_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class Value:
    """`VALUE 1,2:` or `SVALUE "a":`: jumps to the END when reached from above."""

    values: tuple[Expression, ...]
    end_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class Any:
    """`ANY :`, the default branch."""

    end_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class End:
    """`END` of an IF, WHILE, FOR or CASE; `start_at` is the step that opened it."""

    of: str = ""
    start_at: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class Goto:
    """`GOTO label`, `GOTO label IF condition`, `IF condition GOTO label`."""

    label: str
    condition: Expression | None = None
    target: int = UNRESOLVED


@dataclass(frozen=True, slots=True)
class CallStatement:
    """`CALL prog(a, &b, 1+2)`. A Variable or Reference is passed by reference."""

    program: str
    arguments: tuple[Expression | None, ...] = ()


@dataclass(frozen=True, slots=True)
class Scall:
    """`SCALL $name, result`: the name is in a string; result gets the error code."""

    program: Expression
    result: Variable | None = None


@dataclass(frozen=True, slots=True)
class Return:
    """`RETURN`."""


@dataclass(frozen=True, slots=True)
class Print:
    """`PRINT 2: items` or `TYPE items`; items are expressions and `Format`s."""

    name: str
    items: tuple[Expression | None, ...] = ()
    device: Expression | None = None


@dataclass(frozen=True, slots=True)
class Instruction:
    """Any other instruction: full upper-case name, arguments in order, words in order.

    SPEED 30 MM/S ALWAYS   ("SPEED", (30,), ("MM/S", "ALWAYS"))
    PCEXECUTE 2: p,-1      ("PCEXECUTE", (2, Word p, -1)); without a number: 1 (Number)
    PCABORT 2:, PCEND 2:   ("PCABORT", (2,))
    MC EXECUTE p,-1        ("MC EXECUTE", (Word p, -1))
    TIMER 1 = 0, TIMER(1)=0  ("TIMER", (1, 0))
    CP ON                  ("SWITCH", (Word cp,), ("ON",)); RTC_SW 1: ON has (Word, 1)
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


Statement = (
    Comment | Assign | PointStatement | Here | Decompose | If | Else | While | Do | Until | For |
    CaseStatement | Value | Any | End | Goto | CallStatement | Scall | Return | Print | Instruction
)  # fmt: skip

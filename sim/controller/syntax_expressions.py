"""Expression nodes of the syntax tree: values only. `syntax` re-exports them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Number:
    """A real: 8.5E3, ^B101, ^HC1, 'A, TRUE, OFF. Already rounded to single precision."""

    value: float


@dataclass(frozen=True, slots=True)
class Text:
    """A string literal, without its quotes. One character is one byte (Latin-1)."""

    value: str


@dataclass(frozen=True, slots=True)
class Variable:
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


@dataclass(frozen=True, slots=True)
class Unary:
    """An operator before its operand: "-", "NOT" or "COM"."""

    operator: str
    operand: Expression


@dataclass(frozen=True, slots=True)
class Binary:
    """An operator between its operands.

    ^ * / MOD + - < <= == <> >= > BAND BOR BXOR AND OR XOR; `=<`, `=>` and `!=` are stored as
    `<=`, `>=` and `<>`. "+" and "-" of transformations compose them.
    """

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class FunctionCall:
    """A function with its arguments, `None` if one is omitted: TRANS(1,,3), PI, $LEFT($s,1).

    SHIFT(p BY x,y,z) holds (p, x, y, z). SWITCH(CP) and the EXIST functions hold `Word`s.
    """

    name: str
    arguments: tuple[Expression | None, ...] = ()


@dataclass(frozen=True, slots=True)
class JointLiteral:
    """Joint values written out: #[j1,...,j6]."""

    values: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Format:
    """A format of PRINT, TYPE or $ENCODE: /F5.2 is ("F", 5, 2), /S is ("S", None, None)."""

    code: str
    width: int | None = None
    decimals: int | None = None


@dataclass(frozen=True, slots=True)
class Word:
    """A bare name that is not a variable: a program, a switch, a keyword. Lower case."""

    name: str


@dataclass(frozen=True, slots=True)
class Reference:
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

"""Syntax tree builder for expressions and arguments: Lark parse trees to `syntax` values."""

from __future__ import annotations

from dataclasses import dataclass

from lark import Token, Transformer, v_args

from sim.controller import keywords, syntax
from sim.controller.errors import AsError
from sim.controller.syntax import SIGNIFICANT_CHARACTERS, Expression, Statement
from sim.controller.values import MAX_CHARACTERS, single

SPELLINGS = {"=<": "<=", "=>": ">=", "!=": "<>"}


@dataclass(frozen=True, slots=True)
class ParsedLine:
    """One line: its label and its statement (None: label only, or empty line)."""

    label: str | None
    statement: Statement | None


@dataclass(frozen=True, slots=True)
class Slot:
    """One argument with its trailing words: `30 MM/S ALWAYS`."""

    argument: Expression | None
    words: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Prefix:
    """Number of a task, device or robot before a colon: `2:`."""

    number: Expression


def short_name(name: str) -> str:
    """Return the significant part of a name: lower case, 15 characters."""
    return name.lower()[:SIGNIFICANT_CHARACTERS]


def as_number(spelled: str) -> float:
    """Return the value of a number literal: 8.5E3, ^B101, ^HC1 or 'A."""
    if spelled.startswith("'"):
        return float(ord(spelled[1]))
    if spelled.startswith("^"):
        return single(float(int(spelled[2:], 2 if spelled[1] in "Bb" else 16)))
    return single(float(spelled))


def as_word(argument: Expression | None) -> Expression | None:
    """Convert an expression that parsed as a variable or function into a bare word."""
    if isinstance(argument, syntax.Variable) and not argument.indices:
        return syntax.Word(argument.name)
    if isinstance(argument, syntax.FunctionCall) and not argument.arguments:
        return syntax.Word(argument.name.lower())  # SWITCH(ERROR): ERROR is also a function
    return argument


@v_args(inline=True)
class ExpressionBuilder(Transformer[Token, ParsedLine]):
    """Lark transformer with one method per expression rule of the grammar."""

    def number(self, token: Token) -> Expression:
        """`8.5E3`."""
        return syntax.Number(as_number(token.value))

    def string(self, token: Token) -> Expression:
        """`"text"`."""
        return syntax.Text(token.value[1:-1])

    def variable(self, token: Token, *rest: Expression | Brackets) -> Expression:
        """Build a variable, or a constant or function without arguments."""
        local = token.value.startswith(".")
        bare = token.value[1:] if local else token.value
        kind = bare[0] if bare[0] in "$#@&" else ""
        if not rest and not local:
            upper = bare.upper()
            if upper in keywords.CONSTANTS:
                return syntax.Number(keywords.CONSTANTS[upper])
            if upper in keywords.WITHOUT_ARGUMENTS:
                return syntax.FunctionCall(upper)
        indices = rest[0].indices if rest and isinstance(rest[0], Brackets) else ()
        if len(indices) > 3:
            raise AsError("P0119", f"{token.value} has {len(indices)} indices, limit 3")
        name = short_name(bare[len(kind) :])
        whole = bool(rest) and not indices
        if kind == "&":
            return syntax.Reference(syntax.Variable("", name, local, indices, whole))
        return syntax.Variable(kind, name, local, indices, whole)

    def brackets(self, *indices: Expression) -> Brackets:
        """`[1,2]`."""
        return Brackets(indices)

    def function(self, name: Token, arguments: tuple[Slot, ...]) -> Expression:
        """`LEN($s)`."""
        upper = name.value.upper()
        given = tuple(slot.argument for slot in arguments)
        if upper in keywords.WORD_ARGUMENTS:
            given = tuple(as_word(argument) for argument in given)
        return syntax.FunctionCall(upper, () if given == (None,) else given)

    def joint_literal(self, *values: Expression) -> Expression:
        """`#[1,2,3,4,5,6]`."""
        return syntax.JointLiteral(values)

    def binary(self, left: Expression, operator: Token, right: Expression) -> Expression:
        """`a + b`."""
        spelled = operator.value.upper()
        return syntax.Binary(SPELLINGS.get(spelled, spelled), left, right)

    def negative_power(
        self, left: Expression, power: Token, minus: Token, right: Expression
    ) -> Expression:
        """`2 ^ -1`."""
        return syntax.Binary(power.value, left, syntax.Unary(minus.value, right))

    def unary(self, operator: Token, operand: Expression) -> Expression:
        """`-a`, `NOT a`, `COM a`."""
        return syntax.Unary(operator.value.upper(), operand)

    def plus(self, _sign: Token, operand: Expression) -> Expression:
        """`+a`."""
        return operand

    def slot(self, *items: Expression | Token) -> Slot:
        """Build one argument with its words."""
        argument: Expression | None = None
        words = []
        for item in items:
            if isinstance(item, Token) and item.type == "WORD":
                words.append(item.value.upper())
            else:
                argument = _of_token(item) if isinstance(item, Token) else item
        return Slot(argument, tuple(words))

    def arguments(self, *slots: Slot) -> tuple[Slot, ...]:
        """Build a list of arguments."""
        return slots

    def prefix(self, number: Expression) -> Prefix:
        """`2:`."""
        return Prefix(number)

    def parameters(self, *given: syntax.Variable | syntax.Reference) -> tuple[syntax.Variable, ...]:
        """Build the parameter list of a program."""
        return tuple(p.variable if isinstance(p, syntax.Reference) else p for p in given)


@dataclass(frozen=True, slots=True)
class Brackets:
    """Indices of an array element; empty for the whole array."""

    indices: tuple[Expression, ...]


def _of_token(token: Token) -> Expression:
    if token.type == "PROGRAM":
        return syntax.Word(short_name(token.value))
    width, _, decimals = token.value[2:].partition(".")
    if width and int(width) > MAX_CHARACTERS:
        raise AsError("P0108", f"{token.value}: a field has {MAX_CHARACTERS} columns at most")
    return syntax.Format(
        token.value[1].upper(), int(width) if width else None, int(decimals) if decimals else None
    )

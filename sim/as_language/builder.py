"""Syntax tree builder: Lark parse trees of one line to `syntax` values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lark import Token, Transformer, v_args

from sim.as_language import keywords, syntax
from sim.as_language.errors import AsError
from sim.as_language.syntax import SIGNIFICANT_CHARACTERS, Expression, Statement
from sim.as_language.values import MAX_CHARACTERS, single

ONE = syntax.Number(1.0)
SPELLINGS = {"=<": "<=", "=>": ">=", "!=": "<>"}


@dataclass(frozen=True, slots=True)
class ParsedLine:
    """One line: its label and its statement (None: label only, or empty line)."""

    label: str | None
    statement: Statement | None


@dataclass(frozen=True, slots=True)
class Arguments:
    """Arguments with their trailing words: `30 MM/S ALWAYS`; None for an omitted argument."""

    values: tuple[Expression | None, ...]
    words: tuple[str, ...] = ()

    @property
    def given(self) -> tuple[Expression | None, ...]:
        """The arguments; none where there is only an omitted one."""
        return () if self.values == (None,) else self.values


@dataclass(frozen=True, slots=True)
class Prefix:
    """Number of a task, device or robot before a colon: `2:`."""

    number: Expression


@dataclass(frozen=True, slots=True)
class Brackets:
    """Indices of an array element; empty for the whole array."""

    indices: tuple[Expression, ...]


NO_ARGUMENTS = Arguments(())


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
class LineBuilder(Transformer[Token, ParsedLine]):
    """Lark transformer with one method, or the class of the value, per rule of the grammar."""

    if_then = syntax.If
    else_ = syntax.Else
    while_ = syntax.While
    do = syntax.Do
    until = syntax.Until
    any = syntax.Any
    end = syntax.End
    return_ = syntax.Return
    prefix = Prefix

    def line(self, *items: Token | Statement) -> ParsedLine:
        """Combine label and statement."""
        label, statement = None, None
        for item in items:
            if isinstance(item, Token):
                label = short_name(item.value)
            else:
                statement = item
        return ParsedLine(label, statement)

    def assign(self, target: Expression, value: Expression) -> Statement:
        """`x = 1`."""
        return syntax.Assign(_variable(target), value)

    def point(self, *items: Token | Expression) -> Statement:
        """`POINT/X p = q, #c`."""
        part = items[0].value[1:].upper() if isinstance(items[0], Token) else ""
        target, value, *rest = (item for item in items if not isinstance(item, Token))
        return syntax.PointStatement(_variable(target), value, part, rest[0] if rest else None)

    def here(self, place: Expression) -> Statement:
        """`HERE a+b`."""
        if isinstance(place, syntax.Binary) and place.operator == "+":
            return syntax.Here(_variable(place.right), place.left)
        return syntax.Here(_variable(place))

    def decompose(self, target: Expression, value: Expression) -> Statement:
        """`DECOMPOSE x[1] = p`."""
        return syntax.Decompose(_variable(target), value)

    def if_goto(self, condition: Expression, label: Token) -> Statement:
        """`IF c GOTO 10`."""
        return syntax.Goto(short_name(label.value), condition)

    def goto(self, label: Token, condition: Expression | None = None) -> Statement:
        """`GOTO 10 IF c`."""
        return syntax.Goto(short_name(label.value), condition)

    def for_(
        self, variable: Expression, start: Expression, stop: Expression, step: Expression = ONE
    ) -> Statement:
        """`FOR i = 1 TO 9 STEP 2`."""
        return syntax.For(_variable(variable), start, stop, step)

    def case(self, keyword: Token, selector: Expression) -> Statement:
        """`CASE x OF`, `SCASE $x OF`."""
        return syntax.CaseStatement(selector, text=keyword.value == "SCASE")

    def value(self, *values: Expression) -> Statement:
        """`VALUE 1,2:`."""
        return syntax.Value(values)

    def call(self, program: Token, arguments: Arguments = NO_ARGUMENTS) -> Statement:
        """`CALL p(1,x)`."""
        return syntax.CallStatement(short_name(program.value), arguments.given)

    def scall(self, program: Expression, result: Expression | None = None) -> Statement:
        """`SCALL $p,ret`."""
        return syntax.Scall(program, None if result is None else _variable(result))

    def print(self, keyword: Token, *items: Any) -> Statement:
        """`PRINT 2: "x",1`."""
        *prefixes, arguments = items
        device = prefixes[0].number if prefixes else None
        return syntax.Print(keyword.value, arguments.given, device)

    def switch(self, name: Token, *items: Any) -> Statement:
        """`CP ON`, `RTC_SW 1: ON`."""
        *prefixes, state = items
        word = syntax.Word(name.value.lower())
        numbers = (prefix.number for prefix in prefixes)
        return syntax.Instruction("SWITCH", (word, *numbers), (state.value.upper(),))

    def on_call(self, keyword: Token, *items: Any) -> Statement:
        """`ON/ERR 1001 CALL p,10`."""
        return _instruction(keyword, items, "CALL")

    def on_goto(self, keyword: Token, *items: Any) -> Statement:
        """`ON 1001 GOTO 10`."""
        return _instruction(keyword, items, "GOTO")

    def instruction(self, keyword: Token, *items: Any) -> Statement:
        """Build any other instruction: `SPEED 30 MM/S ALWAYS`, `TIMER 1 = 0`."""
        return _instruction(keyword, items)

    def instruction_till(self, keyword: Token, *items: Any) -> Statement:
        """`XMOVE/ERR p TILL 1001`."""
        return _instruction(keyword, items, "TILL")

    # --- expressions ------------------------------------------------------------------------------

    def number(self, token: Token) -> Expression:
        """`8.5E3`."""
        return syntax.Number(as_number(token.value))

    def string(self, token: Token) -> Expression:
        """`"text"`."""
        return syntax.Text(token.value[1:-1])

    def variable(self, token: Token, brackets: Brackets | None = None) -> Expression:
        """Build a variable, or a constant or function without arguments."""
        local = token.value.startswith(".")
        bare = token.value[1:] if local else token.value
        kind = bare[0] if bare[0] in "$#@&" else ""
        if brackets is None and not local:
            upper = bare.upper()
            if upper in keywords.CONSTANTS:
                return syntax.Number(keywords.CONSTANTS[upper])
            if upper in keywords.WITHOUT_ARGUMENTS:
                return syntax.FunctionCall(upper)
        indices = () if brackets is None else brackets.indices
        if len(indices) > 3:
            raise AsError("P0119", f"{token.value} has {len(indices)} indices, limit 3")
        name = short_name(bare[len(kind) :])
        whole = brackets is not None and not indices
        if kind == "&":
            return syntax.Reference(syntax.Variable("", name, local, indices, whole))
        return syntax.Variable(kind, name, local, indices, whole)

    def brackets(self, *indices: Expression) -> Brackets:
        """`[1,2]`."""
        return Brackets(indices)

    def function(self, name: Token, arguments: Arguments) -> Expression:
        """`LEN($s)`."""
        upper, given = name.value.upper(), arguments.given
        if upper in keywords.WORD_ARGUMENTS:
            given = tuple(as_word(argument) for argument in given)
        return syntax.FunctionCall(upper, given)

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

    def slot(self, *items: Expression | Token) -> Arguments:
        """Build one argument with its words."""
        argument: Expression | None = None
        words = []
        for item in items:
            if isinstance(item, Token) and item.type == "WORD":
                words.append(item.value.upper())
            else:
                argument = _of_token(item) if isinstance(item, Token) else item
        return Arguments((argument,), tuple(words))

    def arguments(self, *slots: Arguments) -> Arguments:
        """Build a list of arguments."""
        return Arguments(
            tuple(value for slot in slots for value in slot.values),
            tuple(word for slot in slots for word in slot.words),
        )

    def parameters(self, *given: syntax.Variable | syntax.Reference) -> tuple[syntax.Variable, ...]:
        """Build the parameter list of a program."""
        return tuple(p.variable if isinstance(p, syntax.Reference) else p for p in given)


def _of_token(token: Token) -> Expression:
    if token.type == "PROGRAM":
        return syntax.Word(short_name(token.value))
    width, _, decimals = token.value[2:].partition(".")
    if width and int(width) > MAX_CHARACTERS:
        raise AsError("P0108", f"{token.value}: a field has {MAX_CHARACTERS} columns at most")
    return syntax.Format(
        token.value[1].upper(), int(width) if width else None, int(decimals) if decimals else None
    )


def _variable(expression: Expression) -> syntax.Variable:
    """Return the variable on the left of `=`; P0117 for anything else."""
    if isinstance(expression, syntax.Variable) and not expression.whole:
        return expression
    found = f"the function {expression.name}" if isinstance(expression, syntax.FunctionCall) else (
        "a value, not a variable"
    )  # fmt: skip
    raise AsError("P0117", f"expected a variable or an array element; found {found}")


def _instruction(keyword: Token, items: tuple[Any, ...], last: str = "") -> Statement:
    """Build an instruction; `last` is the keyword inside of it: CALL, GOTO, TILL."""
    number: Expression | None = None
    parts: list[str] = []
    words: list[str] = []
    arguments: list[Expression | None] = []
    for item in items:
        match item:
            case Token(type="PART"):
                parts.append(item.value.upper())
            case Token():
                arguments.append(syntax.Word(short_name(item.value)))
            case Prefix():
                number = item.number
            case Arguments():
                arguments += item.values
                words += item.words
            case _:
                arguments.append(item)
    if arguments == [None]:
        arguments = []
    name = keyword.value.lstrip("?")
    if number is None and name in keywords.TAKES_TASK_NUMBER:
        number = ONE
    if number is not None:
        arguments.insert(0, number)
    modifiers = (*parts, *words, last) if last else (*parts, *words)
    return syntax.Instruction(name, tuple(arguments), modifiers, unknown=keyword.value[0] == "?")

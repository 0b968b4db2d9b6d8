"""Syntax tree builder: Lark parse trees of one line to `syntax` values."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from lark import Token, Transformer, v_args

from sim.as_language import keywords, syntax
from sim.as_language.errors import AsError
from sim.as_language.syntax import SIGNIFICANT_CHARACTERS, Expression, Statement
from sim.as_language.values import MAX_CHARACTERS, single

Argument = Expression | None
ONE = syntax.Number(1.0)
SPELLINGS = {"=<": "<=", "=>": ">=", "!=": "<>", "%": "MOD"}


class ParsedLine(NamedTuple):
    """One line: its label and its statement (None: label only, or empty line)."""

    label: str | None
    statement: Statement | None


def short_name(name: str) -> str:
    """Return the significant part of a name: lower case, 15 characters."""
    return name.lower()[:SIGNIFICANT_CHARACTERS]


def as_word(argument: Expression | None) -> Expression | None:
    """Convert an expression that parsed as a variable or function into a bare word."""
    if isinstance(argument, syntax.Variable) and not argument.indices:
        return syntax.Word(argument.name)
    if isinstance(argument, syntax.FunctionCall) and not argument.arguments:
        return syntax.Word(argument.name.lower())  # SWITCH(ERROR): ERROR is also a function
    return argument


def _define(make: Callable[..., Statement], target: Expression, *rest: Expression) -> Statement:
    """Build a statement that defines a variable."""
    return make(_variable(target), *rest)


@v_args(inline=True)
class LineBuilder(Transformer[Token, ParsedLine]):
    """Lark transformer with one method, or the class of the value, per rule of the grammar.

    A part of a rule in [ ] that is missing is None.
    """

    assign = partial(_define, syntax.Assign)
    decompose = partial(_define, syntax.Decompose)
    for_ = partial(_define, syntax.For)
    if_then = syntax.If
    else_ = syntax.Else
    while_ = syntax.While
    do = syntax.Do
    until = syntax.Until
    any = syntax.Any
    end = syntax.End
    return_ = syntax.Return

    def line(self, label: Token | None, statement: Statement | None) -> ParsedLine:
        """Combine label and statement."""
        return ParsedLine(None if label is None else short_name(label), statement)

    def point(
        self,
        part: Token | None,
        place: Expression,
        value: Expression | None = None,
        configuration: Expression | None = None,
    ) -> Statement:
        """`POINT/X p = q, #c`, `POINT a+b = c`; `POINT p` is an instruction."""
        if value is None:
            return syntax.Instruction("POINT", (place,), () if part is None else (part.upper(),))
        relative_to = None
        if isinstance(place, syntax.Binary) and place.operator == "+":
            relative_to, place = place.left, place.right
        letters = "" if part is None else part[1:].upper()
        return syntax.PointStatement(_variable(place), value, letters, configuration, relative_to)

    def here(self, place: Expression) -> Statement:
        """`HERE a+b`."""
        if isinstance(place, syntax.Binary) and place.operator == "+":
            return syntax.Here(_variable(place.right), place.left)
        return syntax.Here(_variable(place))

    def if_goto(self, condition: Expression, label: Token) -> Statement:
        """`IF c GOTO 10`."""
        return self.goto(label, condition)

    def goto(self, label: Token, condition: Expression | None = None) -> Statement:
        """`GOTO 10 IF c`."""
        return syntax.Goto(short_name(label), condition)

    def case(self, keyword: Token, selector: Expression) -> Statement:
        """`CASE x OF`, `SCASE $x OF`."""
        return syntax.CaseStatement(selector, text=keyword == "SCASE")

    def value(self, *values: Expression) -> Statement:
        """`VALUE 1,2:`."""
        return syntax.Value(values)

    def call(self, program: Token, *arguments: Argument) -> Statement:
        """`CALL p(1,x)`."""
        return syntax.CallStatement(short_name(program), _given(arguments))

    def scall(self, program: Expression, result: Expression | None = None) -> Statement:
        """`SCALL $p,ret`."""
        return syntax.Scall(program, None if result is None else _variable(result))

    def print(self, keyword: Token, device: Expression | None, *items: Argument) -> Statement:
        """`PRINT 2: "x",1`."""
        return syntax.Print(keyword.value, _given(items), device)

    def switch(self, *items: Token | Expression) -> Statement:
        """`CP ON`, `CP, QTOOL OFF`, `RTC_SW 1: ON`."""
        *names, state = [item for item in items if isinstance(item, Token)]
        robots = [f"{item.value:g}:" for item in items if isinstance(item, syntax.Number)]
        arguments = tuple(syntax.Word(name.lower()) for name in names)
        return syntax.Instruction("SWITCH", arguments, (*robots, state.upper()))

    def on(self, keyword: Token, part: Token | None, *items: Argument | Token) -> Statement:
        """`ON/ERR 1001 CALL p,10`, `ON 1001 GOTO 10`, `XMOVE/ERR p TILL 1001`."""
        return self.instruction(keyword, part, None, *items)

    def instruction(
        self,
        keyword: Token,
        part: Token | None,
        number: Expression | None,
        *items: Argument | Token,
    ) -> Statement:
        """Build any other instruction: `SPEED 30 MM/S ALWAYS`, `TIMER 1 = 0`."""
        name = keyword.lstrip("?")
        words = [item.upper() for item in (part, *items) if isinstance(item, Token)]
        arguments = _given(tuple(item for item in items if not isinstance(item, Token)))
        if number is None and name in keywords.TAKES_TASK_NUMBER:
            number = ONE
        if isinstance(number, syntax.Number) and name.startswith("MC "):
            words.append(f"{number.value:g}:")  # the number of a robot
            number = None
        if name == "PROMPT":
            number = None  # the number of a device: all share one terminal
        if number is not None:
            arguments = (number, *arguments)
        return syntax.Instruction(name, arguments, tuple(words), unknown=keyword[0] == "?")

    # --- arguments --------------------------------------------------------------------------------

    def omitted(self) -> None:
        """Return None for an argument that is left out: `DRAW ,,10`."""

    def word(self, name: Token) -> Expression:
        """`p` of `PCEXECUTE p`."""
        return syntax.Word(short_name(name))

    def format(self, token: Token) -> Expression:
        """`/F5.2`."""
        width, _, decimals = token[2:].partition(".")
        if width and int(width) > MAX_CHARACTERS:
            raise AsError("P0108", f"{token}: a field has {MAX_CHARACTERS} columns at most")
        return syntax.Format(
            token[1].upper(), int(width) if width else None, int(decimals) if decimals else None
        )

    def parameters(self, *given: syntax.Variable | syntax.Reference) -> tuple[syntax.Variable, ...]:
        """Build the parameter list of a program."""
        return tuple(p.variable if isinstance(p, syntax.Reference) else p for p in given)

    # --- expressions ------------------------------------------------------------------------------

    def number(self, token: Token) -> Expression:
        """`8.5E3`, `^B101`, `^HC1`, `'A`."""
        if token[0] == "'":
            return syntax.Number(float(ord(token[1])))
        if token[0] == "^":
            return syntax.Number(single(float(int(token[2:], 2 if token[1] in "Bb" else 16))))
        return syntax.Number(single(float(token)))

    def string(self, token: Token) -> Expression:
        """`"text"`."""
        return syntax.Text(token[1:-1])

    def variable(self, token: Token, indices: tuple[Expression, ...] | None = None) -> Expression:
        """Build a variable, or a constant or function without arguments."""
        local = token.startswith(".")
        bare = token.removeprefix(".")
        kind = bare[0] if bare[0] in "$#@&" else ""
        if indices is None and not local:
            upper = bare.upper()
            if upper in keywords.CONSTANTS:
                return syntax.Number(keywords.CONSTANTS[upper])
            if upper in keywords.WITHOUT_ARGUMENTS:
                return syntax.FunctionCall(upper)
        whole = indices == ()
        indices = indices or ()
        if len(indices) > 3:
            raise AsError("P0119", f"{token} has {len(indices)} indices, limit 3")
        name = short_name(bare.removeprefix(kind))
        if kind == "&":
            return syntax.Reference(syntax.Variable("", name, local, indices, whole))
        return syntax.Variable(kind, name, local, indices, whole)

    def brackets(self, *indices: Expression) -> tuple[Expression, ...]:
        """`[1,2]`; of the whole array, `[]`, there are none."""
        return indices

    def function(self, name: Token, *arguments: Argument) -> Expression:
        """`LEN($s)`."""
        upper, given = name.upper(), _given(arguments)
        word = keywords.WORD_ARGUMENTS.get(upper)
        if word is not None:
            given = (*given[:word], *map(as_word, given[word : word + 1]), *given[word + 1 :])
        return syntax.FunctionCall(upper, given)

    def joint_literal(self, *values: Expression) -> Expression:
        """`#[1,2,3,4,5,6]`."""
        return syntax.JointLiteral(values)

    def binary(self, left: Expression, operator: Token, right: Expression) -> Expression:
        """`a + b`."""
        spelled = operator.upper()
        return syntax.Binary(SPELLINGS.get(spelled, spelled), left, right)

    def negative_power(
        self, left: Expression, power: Token, minus: Token, right: Expression
    ) -> Expression:
        """`2 ^ -1`."""
        return syntax.Binary(power.value, left, syntax.Unary(minus.value, right))

    def unary(self, operator: Token, operand: Expression) -> Expression:
        """`-a`, `NOT a`, `COM a`."""
        return syntax.Unary(operator.upper(), operand)

    def plus(self, _sign: Token, operand: Expression) -> Expression:
        """`+a`."""
        return operand


def _given(arguments: tuple[Argument, ...]) -> tuple[Argument, ...]:
    """Return the arguments; none where there is only an omitted one."""
    return () if arguments == (None,) else arguments


def _variable(expression: Expression) -> syntax.Variable:
    """Return the variable on the left of `=`; P0117 for anything else."""
    if isinstance(expression, syntax.Variable) and not expression.whole:
        return expression
    found = f"the function {expression.name}" if isinstance(expression, syntax.FunctionCall) else (
        "a value, not a variable"
    )  # fmt: skip
    raise AsError("P0117", f"expected a variable or an array element; found {found}")

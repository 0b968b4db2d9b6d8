"""Syntax tree builder for statements: Lark parse trees to `syntax` values."""

from lark import Token, v_args

from sim.controller import keywords, syntax
from sim.controller.builder import ExpressionBuilder, ParsedLine, Prefix, Slot, short_name
from sim.controller.errors import AsError
from sim.controller.syntax import Expression, Statement

ONE = syntax.Number(1.0)


@v_args(inline=True)
class LineBuilder(ExpressionBuilder):
    """Lark transformer with one method per statement of the grammar."""

    def line(self, *items: Token | Statement) -> ParsedLine:
        """Combine label and statement."""
        label = next((short_name(item.value) for item in items if isinstance(item, Token)), None)
        return ParsedLine(
            label, next((item for item in items if not isinstance(item, Token)), None)
        )

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

    def if_then(self, condition: Expression) -> Statement:
        """`IF c THEN`."""
        return syntax.If(condition)

    def if_goto(self, condition: Expression, label: Token) -> Statement:
        """`IF c GOTO 10`."""
        return syntax.Goto(short_name(label.value), condition)

    def goto(self, label: Token, condition: Expression | None = None) -> Statement:
        """`GOTO 10 IF c`."""
        return syntax.Goto(short_name(label.value), condition)

    def else_(self) -> Statement:
        """`ELSE`."""
        return syntax.Else()

    def while_(self, condition: Expression) -> Statement:
        """`WHILE c DO`."""
        return syntax.While(condition)

    def do(self) -> Statement:
        """`DO`."""
        return syntax.Do()

    def until(self, condition: Expression) -> Statement:
        """`UNTIL c`."""
        return syntax.Until(condition)

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

    def any(self) -> Statement:
        """`ANY :`."""
        return syntax.Any()

    def end(self) -> Statement:
        """`END`."""
        return syntax.End()

    def call(self, program: Token, arguments: tuple[Slot, ...] = ()) -> Statement:
        """`CALL p(1,x)`."""
        given = tuple(slot.argument for slot in arguments)
        return syntax.CallStatement(short_name(program.value), () if given == (None,) else given)

    def scall(self, program: Expression, result: Expression | None = None) -> Statement:
        """`SCALL $p,ret`."""
        return syntax.Scall(program, None if result is None else _variable(result))

    def return_(self) -> Statement:
        """`RETURN`."""
        return syntax.Return()

    def print(self, keyword: Token, *items: Prefix | tuple[Slot, ...]) -> Statement:
        """`PRINT 2: "x",1`."""
        slots, device = _slots(items)
        given = tuple(slot.argument for slot in slots)
        return syntax.Print(keyword.value, () if given == (None,) else given, device)

    def switch(self, name: Token, *items: Prefix | Token) -> Statement:
        """`CP ON`."""
        prefixes = tuple(item.number for item in items if isinstance(item, Prefix))
        state = str(items[-1].value.upper()) if isinstance(items[-1], Token) else ""
        word = syntax.Word(name.value.lower())
        return syntax.Instruction("SWITCH", (word, *prefixes), (state,))

    def on_call(self, keyword: Token, *items: Token | tuple[Slot, ...] | Expression) -> Statement:
        """`ON/ERR 1001 CALL p,10`."""
        return _on(keyword, items, "CALL")

    def on_goto(self, keyword: Token, *items: Token | tuple[Slot, ...] | Expression) -> Statement:
        """`ON 1001 GOTO 10`."""
        return _on(keyword, items, "GOTO")

    def instruction(self, keyword: Token, *items: Token | Prefix | tuple[Slot, ...]) -> Statement:
        """Build any other instruction: `SPEED 30 MM/S ALWAYS`, `TIMER 1 = 0`."""
        return _instruction(keyword, items, ())

    def instruction_till(self, keyword: Token, *items: Token | tuple[Slot, ...]) -> Statement:
        """`XMOVE/ERR p TILL 1001`."""
        return _instruction(keyword, items, ("TILL",))


def _variable(expression: Expression) -> syntax.Variable:
    """Return the variable on the left of `=`; P0117 for anything else."""
    if isinstance(expression, syntax.Variable) and not expression.whole:
        return expression
    found = f"the function {expression.name}" if isinstance(expression, syntax.FunctionCall) else (
        "a value, not a variable"
    )  # fmt: skip
    raise AsError("P0117", f"expected a variable or an array element; found {found}")


def _slots(items: tuple[object, ...]) -> tuple[list[Slot], Expression | None]:
    slots = [slot for item in items if isinstance(item, tuple) for slot in item]
    prefixes = [item.number for item in items if isinstance(item, Prefix)]
    return slots, prefixes[0] if prefixes else None


def _parts(items: tuple[object, ...]) -> tuple[str, ...]:
    return tuple(i.value.upper() for i in items if isinstance(i, Token) and i.type == "PART")


def _instruction(keyword: Token, items: tuple[object, ...], last: tuple[str, ...]) -> Statement:
    slots, number = _slots(items)
    name = keyword.value.lstrip("?")
    arguments = [slot.argument for slot in slots]
    if arguments == [None]:
        arguments = []
    if name in keywords.TAKES_TASK_NUMBER:
        arguments.insert(0, ONE if number is None else number)
    elif number is not None:
        arguments.insert(0, number)
    words = tuple(word for slot in slots for word in slot.words)
    return syntax.Instruction(
        name, tuple(arguments), (*_parts(items), *words, *last), unknown=keyword.value[0] == "?"
    )


def _on(keyword: Token, items: tuple[object, ...], word: str) -> Statement:
    slots, _ = _slots(items)
    arguments: list[Expression | None] = [slot.argument for slot in slots]
    for item in items:
        if isinstance(item, Token) and item.type in {"PROGRAM", "TARGET"}:
            arguments.append(syntax.Word(short_name(item.value)))
        elif not isinstance(item, Token | tuple):
            arguments.append(item)  # type: ignore[arg-type]
    return syntax.Instruction(keyword.value, tuple(arguments), (*_parts(items), word))

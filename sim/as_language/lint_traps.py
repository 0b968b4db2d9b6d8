"""Lint rules on the expressions and instructions of a step."""

from collections.abc import Iterator

from sim.as_language import syntax
from sim.as_language.findings import LintFinding, at
from sim.as_language.formats import OPTIONAL
from sim.as_language.functions_text import DECIMAL
from sim.as_language.operators import LOGIC, RELATIONS
from sim.as_language.syntax import (
    Binary,
    Expression,
    FunctionCall,
    Number,
    Program,
    ProgramStep,
    SourceFile,
)
from sim.as_language.walk import nodes, steps_with_nodes

TRUTHS = frozenset({"SIG", "SWITCH"})
ONE = Number(1.0)
# Argument index of time-out (1 to 60 s) and port (8192 to 65535) of each TCP instruction.
TIMEOUTS = {"TCP_ACCEPT": 2, "TCP_CONNECT": 3, "TCP_SEND": 4, "TCP_RECV": 4}
PORTS = {"TCP_LISTEN": 1, "TCP_ACCEPT": 1, "TCP_END_LISTEN": 1}


def traps(source: SourceFile) -> Iterator[LintFinding]:
    """Yield warnings about statements that are valid but probably unintended."""
    flags = set(_flags(source))
    for program in source.programs.values():
        for step, node in steps_with_nodes(program):
            yield from _expression(program, step, node)
            yield from _instruction(program, step, node)
            if _is_compared_with_1(node, flags):
                yield at(program, step, "true-is-minus-1", "TRUE is -1: compared with 1 it is"
                         " never equal; write the condition alone, or == TRUE")  # fmt: skip


def _expression(program: Program, step: ProgramStep, node: object) -> Iterator[LintFinding]:
    match node:
        case Binary(operator, syntax.Unary("NOT"), _) if operator in RELATIONS:
            text = f"NOT binds tighter than {operator}: NOT a {operator} b is (NOT a) {operator} b"
            yield at(program, step, "not-relation", text)
        case Binary("+", left, Binary(operator, right, _)) if operator in RELATIONS and (
            _is_text(left) or _is_text(right)
        ):
            text = f"a comparison of strings binds tighter than +: $a+$b {operator} $c needs ( )"
            yield at(program, step, "text-relation", text)
        case syntax.Format(code) if code in OPTIONAL:
            yield at(program, step, "optional-format", f"/{code} is an option of the controller")
        case FunctionCall("VAL", (syntax.Text(value), *_)) if not _is_number(value):
            yield at(program, step, "val", f"the result of VAL for {value!a} is not documented")
        case _:
            pass


def _instruction(program: Program, step: ProgramStep, node: object) -> Iterator[LintFinding]:
    match node:
        case syntax.Goto(label=label, target=syntax.UNRESOLVED):
            yield at(program, step, "E0101", f"there is no label {label} in {program.name}")
        case syntax.CaseStatement(selector, text=False) if _is_text(selector):
            yield at(program, step, "text-case", "CASE takes a number; a string needs SCASE")
        case syntax.Instruction(name=name, arguments=arguments):
            yield from _tcp(program, step, name, arguments)
        case syntax.ProgramStep() | _ if step.label == "any" and node is step.statement:
            yield at(program, step, "any-label", "ANY: without a blank before the colon is a label")


def _tcp(
    program: Program, step: ProgramStep, name: str, arguments: tuple[Expression | None, ...]
) -> Iterator[LintFinding]:
    timeout_s = _constant(arguments, TIMEOUTS.get(name))
    if timeout_s is not None and not 1.0 <= timeout_s <= 60.0:
        text = f"the time-out of {name} is 1 to 60 s, not {timeout_s:g}; less may not be honoured"
        yield at(program, step, "tcp-timeout", text)
    port = _constant(arguments, PORTS.get(name))
    if port is not None and not 8192 <= port <= 65535:
        yield at(program, step, "tcp-port", f"ports are 8192 to 65535, not {port:g}")


def _constant(arguments: tuple[Expression | None, ...], index: int | None) -> float | None:
    given = arguments[index] if index is not None and index < len(arguments) else None
    return given.value if isinstance(given, Number) else None


def _flags(source: SourceFile) -> Iterator[str]:
    """Yield the variables to which TRUE or a condition is assigned."""
    for program in source.programs.values():
        for step in program.steps:
            statement = step.statement
            if isinstance(statement, syntax.Assign) and _is_truth(statement.value):
                yield statement.target.spelling


def _is_truth(value: Expression) -> bool:
    match value:
        case Number(-1.0) | syntax.Unary("NOT"):
            return True
        case Binary(operator):
            return operator in RELATIONS or operator in LOGIC
        case FunctionCall(name):
            return name in TRUTHS
        case _:
            return False


def _is_compared_with_1(node: object, flags: set[str]) -> bool:
    if not isinstance(node, Binary) or node.operator not in {"==", "<>"}:
        return False
    if ONE not in {node.left, node.right}:
        return False
    other = node.left if node.right == ONE else node.right
    if isinstance(other, syntax.Variable):
        return other.spelling in flags
    return _is_truth(other) and not isinstance(other, Number)


def _is_text(node: Expression) -> bool:
    """Return whether an expression is a string, judged by its outermost operand."""
    for inner in nodes(node):
        if isinstance(inner, Binary) and inner.operator == "+":
            continue
        if isinstance(inner, FunctionCall):
            return inner.name.startswith("$")
        return isinstance(inner, syntax.Text) or getattr(inner, "kind", "") == "$"
    return False


def _is_number(value: str) -> bool:
    return value[:2].upper() in {"^H", "^B"} or DECIMAL.match(value) is not None

"""Lint rules on one step: constructs that are not executed, and valid ones that mean another thing.

A rule yields its name and a message.
"""

from collections.abc import Iterator

from sim.as_language import keywords, syntax
from sim.as_language.errors import AsError
from sim.as_language.findings import LintFinding, at, nodes, steps
from sim.as_language.formats import OPTIONAL, WRITERS
from sim.as_language.functions_text import DECIMAL
from sim.as_language.operators import LOGIC, RELATIONS
from sim.as_language.special_functions import ALL_NAMES, FUNCTIONS
from sim.as_language.syntax import (
    Binary,
    Expression,
    FunctionCall,
    Number,
    Program,
    ProgramStep,
    SourceFile,
)

TRUTHS = frozenset({"SIG", "SWITCH"})
POINT_PARTS = frozenset({"", "X", "Y", "Z", "OAT", "O", "A", "T"})
LAYOUT = frozenset({*WRITERS, *OPTIONAL, "C", "S", "X"})
ONE = Number(1.0)
# Argument index of time-out (1 to 60 s) and port (8192 to 65535) of each TCP instruction.
TIMEOUTS = {"TCP_ACCEPT": 2, "TCP_CONNECT": 3, "TCP_SEND": 4, "TCP_RECV": 4}
PORTS = {"TCP_LISTEN": 1, "TCP_ACCEPT": 1, "TCP_END_LISTEN": 1}

Found = Iterator[tuple[str, str]]


def step_traps(source: SourceFile) -> Iterator[LintFinding]:
    """Yield the findings in the steps of a file."""
    flags = {
        step.statement.target.spelling
        for _, step in steps(source)
        if isinstance(step.statement, syntax.Assign) and _is_truth(step.statement.value)
    }
    for program, step in steps(source):
        for node in nodes(step.statement):
            for rule, text in (
                *_unsupported(node),
                *_expression(node, flags),
                *_statement(program, step, node),
            ):
                yield at(program, step, rule, text)


def _unsupported(node: object) -> Found:
    match node:
        case syntax.Instruction(name=name, unknown=unknown) if name not in keywords.EMULATED:
            what = "unknown instruction" if unknown else "instruction that is not emulated"
            yield "instruction", f"{what}: {name}"
        case FunctionCall(name=name) if name not in ALL_NAMES:
            yield "function", f"unknown function: {name}"
        case FunctionCall(name=name, arguments=arguments) if name in FUNCTIONS:
            try:
                FUNCTIONS[name].check_count(name, len(arguments))
            except AsError as error:
                yield error.code, error.detail
        case syntax.PointStatement(part=part) if part not in POINT_PARTS:
            yield "instruction", f"POINT/{part}"
        case syntax.Format(code=code) if code not in LAYOUT:
            yield "format", f"unknown format: /{code}"
        case _:
            pass


def _expression(node: object, flags: set[str]) -> Found:
    match node:
        case Binary(operator, syntax.Unary("NOT"), _) if operator in RELATIONS:
            text = f"NOT binds tighter than {operator}: NOT a {operator} b is (NOT a) {operator} b"
            yield "not-relation", text
        case Binary("+", left, Binary(operator, right, _)) if operator in RELATIONS and (
            _is_text(left) or _is_text(right)
        ):
            text = f"a comparison of strings binds tighter than +: $a+$b {operator} $c needs ( )"
            yield "text-relation", text
        case syntax.Format(code) if code in OPTIONAL:
            yield "optional-format", f"/{code} is an option of the controller"
        case FunctionCall("VAL", (syntax.Text(value), *_)) if not _is_number(value):
            yield "val", f"the result of VAL for {value!a} is not documented"
        case _:
            pass
    if _is_compared_with_1(node, flags):
        text = "TRUE is -1: compared with 1 it is never equal"
        yield "true-is-minus-1", f"{text}; write the condition alone, or == TRUE"


def _statement(program: Program, step: ProgramStep, node: object) -> Found:
    match node:
        case syntax.Goto(label=label, target=syntax.UNRESOLVED):
            yield "E0101", f"there is no label {label} in {program.name}"
        case syntax.CaseStatement(selector, text=False) if _is_text(selector):
            yield "text-case", "CASE takes a number; a string needs SCASE"
        case syntax.Instruction(name=name, arguments=arguments):
            timeout_s = _constant(arguments, TIMEOUTS.get(name))
            if timeout_s is not None and not 1.0 <= timeout_s <= 60.0:
                text = f"the time-out of {name} is 1 to 60 s, not {timeout_s:g}"
                yield "tcp-timeout", f"{text}; less may not be honoured"
            port = _constant(arguments, PORTS.get(name))
            if port is not None and not 8192 <= port <= 65535:
                yield "tcp-port", f"ports are 8192 to 65535, not {port:g}"
        case _ if step.label == "any" and node is step.statement:
            yield "any-label", "ANY: without a blank before the colon is a label"
        case _:
            pass


def _constant(arguments: tuple[Expression | None, ...], index: int | None) -> float | None:
    given = arguments[index] if index is not None and index < len(arguments) else None
    return given.value if isinstance(given, Number) else None


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

"""Lint rules on one step and across programs, and the findings of all rules.

On a step: constructs that are not executed, and valid ones that mean another thing; a rule yields
its name and a message. Across programs: subroutines shared by tasks, invalid CALLs.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from sim.as_language import keywords, syntax
from sim.as_language.errors import AsError
from sim.as_language.formats import OPTIONAL, WRITERS
from sim.as_language.functions import DECIMAL, FUNCTIONS
from sim.as_language.operators import LOGIC, RELATIONS
from sim.as_language.special_functions import ALL_NAMES
from sim.as_language.syntax import (
    Binary,
    Expression,
    FunctionCall,
    Node,
    Number,
    Program,
    ProgramStep,
    SourceFile,
    SourcePosition,
)

# Rules for what the emulator parses but cannot execute.
NOT_EXECUTED = keywords.words("instruction function format")


class LintFinding(NamedTuple):
    """One finding: an unsupported construct or a warning."""

    where: SourcePosition
    rule: str
    text: str
    program: str = ""
    step: int = 0

    @property
    def kind(self) -> str:
        """`not executed` or `warning`."""
        return "not executed" if self.rule in NOT_EXECUTED else "warning"

    def __str__(self) -> str:
        place = f" ({self.program} step {self.step})" if self.step else ""
        return f"{self.where}: {self.kind}: {self.text} [{self.rule}]{place}"


def at(program: Program, step: ProgramStep, rule: str, text: str) -> LintFinding:
    """Return a finding at a step."""
    return LintFinding(step.where, rule, text, program.name, step.number)


def nodes(node: object) -> Iterator[object]:
    """Yield a statement or expression and everything inside it, outer ones first."""
    stack = [node]
    while stack:
        top = stack.pop()
        if isinstance(top, tuple):
            stack.extend(reversed(top))
        elif isinstance(top, Node):
            yield top
            stack.extend(reversed(top.parts()))


def steps(source: SourceFile) -> Iterator[tuple[Program, ProgramStep]]:
    """Yield every step of a file with its program."""
    for program in source.programs.values():
        for step in program.steps:
            yield program, step


# --- steps ----------------------------------------------------------------------------------------

TRUTHS = keywords.words("SIG SWITCH")
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
            block = name in keywords.BLOCK_STEPS and not unknown
            yield "instruction", f"{'block step of the pendant' if block else what}: {name}"
        case syntax.Instruction("SWITCH", names):
            for name in (item.name for item in names if isinstance(item, syntax.Word)):
                if name not in keywords.SWITCHES:
                    yield "instruction", f"unknown switch: {name.upper()}"
        case FunctionCall(name=name) if name not in ALL_NAMES:
            yield "function", f"unknown function: {name}"
        case FunctionCall(name=name, arguments=arguments) if name in FUNCTIONS:
            try:
                FUNCTIONS[name].check_count(name, len(arguments))
            except AsError as error:
                yield error.code, error.detail
        case syntax.PointStatement(part=part) if part and part not in keywords.POINT_PARTS:
            yield "instruction", f"POINT/{part}"
        case syntax.Format(code=code) if code not in LAYOUT:
            yield "format", f"unknown format: /{code}"


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


# --- programs -------------------------------------------------------------------------------------

MOTION = keywords.words("""
    JMOVE LMOVE HMOVE JAPPRO LAPPRO JDEPART LDEPART HOME DRIVE DRAW TDRAW ALIGN XMOVE C1MOVE C2MOVE
    DELAY STABLE MVWAIT ONI
    """)
FRAMES = keywords.words("BASE TOOL")


def task_traps(source: SourceFile) -> Iterator[LintFinding]:
    """Yield warnings about calls, shared subroutines and statements not allowed in a task."""
    programs = source.programs
    calls = {name: set(_called(program)) for name, program in programs.items()}
    background = _background(source)
    in_background = {root: _reached(root, calls) for root in sorted(background)}
    called_names = {name for names in calls.values() for name in names}
    roots = [name for name in programs if name not in called_names and name not in background]
    robot = {name for root in roots for name in _reached(root, calls)}
    for program, step in steps(source):
        yield from _call(program, step, programs)
    yield from _shared(programs, {"the robot program": robot, **in_background})
    for root, reached in in_background.items():
        for name in sorted(reached & programs.keys()):
            yield from _forbidden(programs[name], root)


def _called(program: Program) -> Iterator[str]:
    for step in program.steps:
        match step.statement:
            case syntax.CallStatement(program=name):
                yield name
            case syntax.Instruction(name="ONE" | "ON" | "ONI", arguments=arguments):
                yield from (item.name for item in arguments if isinstance(item, syntax.Word))


def _background(source: SourceFile) -> set[str]:
    """Return the programs that run as PC programs."""
    found = {name for name in source.programs if name.startswith("autostart") and ".pc" in name}
    for _, step in steps(source):
        match step.statement:
            case syntax.Instruction(name="PCEXECUTE", arguments=(_, syntax.Word(name), *_)):
                found.add(name)
    return found


def _reached(root: str, calls: Mapping[str, set[str]]) -> set[str]:
    reached: set[str] = set()
    waiting = [root]
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting.extend(calls.get(name, ()))
    return reached


def _shared(
    programs: Mapping[str, Program], tasks: Mapping[str, set[str]]
) -> Iterator[LintFinding]:
    for name, program in programs.items():
        users = [task for task, reached in tasks.items() if name in reached]
        if len(users) > 1 and name not in tasks:
            text = f"{name} is called from {' and '.join(users)}: in two tasks at once it is P1014"
            yield LintFinding(program.where, "shared-program", text, program=name)


def _call(
    program: Program, step: ProgramStep, programs: Mapping[str, Program]
) -> Iterator[LintFinding]:
    if not isinstance(step.statement, syntax.CallStatement):
        return
    name, arguments = step.statement.program, step.statement.arguments
    called = programs.get(name)
    if called is None:
        yield at(program, step, "no-program", f"there is no program {name} in the file")
        return
    parameters = called.parameters
    if len(parameters) != len(arguments):
        text = f"{name} takes {len(parameters)} arguments, not {len(arguments)}"
        yield at(program, step, "P0137", text)
        return
    for number, (given, parameter) in enumerate(zip(arguments, parameters, strict=True), 1):
        variable = passed_variable(given)
        if isinstance(variable, syntax.Variable) and variable.kind != parameter.kind:
            text = f"argument {number} of {name} is {variable.spelling}, "
            yield at(program, step, "P0138", f"{text}the parameter is {parameter.spelling}")


def passed_variable(argument: Expression | None) -> Expression | None:
    """Return the variable that an argument of CALL passes, or else the argument."""
    return argument.variable if isinstance(argument, syntax.Reference) else argument


def _forbidden(program: Program, root: str) -> Iterator[LintFinding]:
    for step in program.steps:
        for node in nodes(step.statement):
            match node:
                case syntax.Instruction(name=name) if name in MOTION:
                    text = f"{name} in PC program {root}: motion belongs in the robot program"
                    yield at(program, step, "E1095", text)
                case syntax.Instruction(name=name) | FunctionCall(name=name) if name in FRAMES:
                    text = f"{name} cannot be used in PC program {root}"
                    yield at(program, step, "pc-frame", text)

"""Lint rules on variables: never defined, two kinds under one name, reserved words."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from sim.as_language import keywords, syntax
from sim.as_language.findings import LintFinding, at
from sim.as_language.memory import key_of
from sim.as_language.special_functions import ALL_NAMES
from sim.as_language.syntax import Program, ProgramStep, SourceFile, Variable
from sim.as_language.walk import nodes

RESERVED = keywords.KNOWN | keywords.OPERATORS | keywords.STATEMENTS.keys() | ALL_NAMES
# Instructions that write into their arguments.
WRITERS = frozenset(
    {"TCP_LISTEN", "TCP_ACCEPT", "TCP_CONNECT", "TCP_SEND", "TCP_RECV", "TCP_CLOSE",
     "TCP_END_LISTEN", "TCP_STATUS", "TCP_ISLINK", "UDP_SENDTO", "UDP_RECVFROM", "PROMPT"}
)  # fmt: skip


@dataclass(slots=True)
class Uses:
    """Uses of a variable: first position, and kinds of use."""

    place: tuple[Program, ProgramStep]
    defined: bool = False
    scalar: bool = False
    array: bool = False
    kinds: set[str] = field(default_factory=set)


def name_traps(source: SourceFile) -> Iterator[LintFinding]:
    """Yield warnings about the variables of a file."""
    shared: dict[str, Uses] = {}
    for item in source.data:
        uses = Uses(
            (Program("", (), (), item.where), ProgramStep(0, syntax.Comment(), item.where)),
            defined=True,
        )
        shared.setdefault(key_of(item.variable), uses)
    for program in source.programs.values():
        own: dict[str, Uses] = {}
        for step in program.steps:
            _note(program, step, own, shared)
        for parameter in program.parameters:
            if key_of(parameter) in own:
                own[key_of(parameter)].defined = True
        yield from _judge(own, ".")
    yield from _judge(shared, "")


def _note(
    program: Program, step: ProgramStep, own: dict[str, Uses], shared: dict[str, Uses]
) -> None:
    written = dict(_written(step.statement))
    for node in nodes(step.statement):
        if not isinstance(node, Variable):
            continue
        uses = (own if node.local else shared).setdefault(key_of(node), Uses((program, step)))
        kind = written.get(id(node))
        if kind is not None:
            uses.defined = True
            uses.kinds.add(kind)
        if kind != "passed":
            uses.array |= bool(node.indices) or node.whole
            uses.scalar |= not (node.indices or node.whole)


def _written(statement: syntax.Statement) -> Iterator[tuple[int, str]]:
    """Yield the identity of each variable that a statement defines, and its kind."""
    match statement:
        case syntax.Assign(target) | syntax.For(target):
            yield id(target), "real"
        case syntax.PointStatement(target) | syntax.Here(target):
            yield id(target), "location"
        case syntax.Decompose(target):
            yield id(target), "passed"
        case syntax.CallStatement(arguments=arguments):
            yield from ((id(_variable(item)), "passed") for item in arguments)
        case syntax.Scall(result=result):
            yield id(result), "real"
        case syntax.Instruction(name=name, arguments=arguments) if name in WRITERS:
            yield from ((id(item), "passed") for item in arguments)
        case _:
            pass


def _variable(item: syntax.Expression | None) -> object:
    return item.variable if isinstance(item, syntax.Reference) else item


def _judge(names: dict[str, Uses], dot: str) -> Iterator[LintFinding]:
    for key, uses in names.items():
        program, step = uses.place
        name = f"{dot}{key}"
        if not uses.defined:
            yield at(program, step, "never-defined", f"{name} is never defined in this file")
        if uses.scalar and uses.array:
            text = f"{name} is used with and without an index (P0132, P0133)"
            yield at(program, step, "scalar-and-array", text)
        if {"real", "location"} <= uses.kinds:
            text = f"{name} is a real here and a transformation there (P0150)"
            yield at(program, step, "two-types", text)
        if not dot and key.upper() in RESERVED:
            yield at(program, step, "reserved", f"{name} is a reserved word of AS (P0117)")

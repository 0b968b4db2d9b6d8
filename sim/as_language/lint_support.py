"""Lint rules for constructs that the emulator parses but cannot execute."""

from collections.abc import Iterator

from sim.as_language import keywords, syntax
from sim.as_language.errors import AsError
from sim.as_language.findings import LintFinding, at
from sim.as_language.formats import WRITERS
from sim.as_language.special_functions import ALL_NAMES, FUNCTIONS
from sim.as_language.syntax import Program, ProgramStep, SourceFile
from sim.as_language.walk import steps_with_nodes

POINT_PARTS = frozenset({"", "X", "Y", "Z", "OAT", "O", "A", "T"})
LAYOUT = frozenset({*WRITERS, "C", "S", "X"})


def not_executed(source: SourceFile) -> Iterator[LintFinding]:
    """Yield instructions, functions and formats that are not emulated."""
    for program in source.programs.values():
        for step, node in steps_with_nodes(program):
            yield from _node(program, step, node)


def _node(program: Program, step: ProgramStep, node: object) -> Iterator[LintFinding]:
    match node:
        case syntax.Instruction(name=name, unknown=unknown) if name not in keywords.EMULATED:
            what = "unknown instruction" if unknown else "instruction that is not emulated"
            yield at(program, step, "instruction", f"{what}: {name}", kind="not executed")
        case syntax.FunctionCall(name=name) if name not in ALL_NAMES:
            text = f"unknown function: {name}"
            yield at(program, step, "function", text, kind="not executed")
        case syntax.FunctionCall(name=name, arguments=arguments) if name in FUNCTIONS:
            try:
                FUNCTIONS[name].check_count(name, len(arguments))
            except AsError as error:
                yield at(program, step, error.code, error.detail)
        case syntax.PointStatement(part=part) if part not in POINT_PARTS:
            yield at(program, step, "instruction", f"POINT/{part}", kind="not executed")
        case syntax.Format(code=code) if code not in LAYOUT:
            yield at(program, step, "format", f"unknown format: /{code}", kind="not executed")
        case _:
            pass

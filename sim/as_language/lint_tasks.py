"""Lint rules across programs: subroutines shared by tasks, invalid CALLs."""

from collections.abc import Iterator, Mapping

from sim.as_language import syntax
from sim.as_language.findings import LintFinding, at, nodes, steps
from sim.as_language.syntax import FunctionCall, Program, ProgramStep, SourceFile

MOTION = frozenset(
    {"JMOVE", "LMOVE", "HMOVE", "JAPPRO", "LAPPRO", "JDEPART", "LDEPART", "HOME", "DRIVE", "DRAW",
     "TDRAW", "ALIGN", "XMOVE", "C1MOVE", "C2MOVE", "DELAY", "STABLE", "MVWAIT", "ONI"}
)  # fmt: skip
FRAMES = frozenset({"BASE", "TOOL"})


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
            case _:
                pass


def _background(source: SourceFile) -> set[str]:
    """Return the programs that run as PC programs."""
    found = {name for name in source.programs if name.startswith("autostart") and ".pc" in name}
    for _, step in steps(source):
        match step.statement:
            case syntax.Instruction(name="PCEXECUTE", arguments=(_, syntax.Word(name), *_)):
                found.add(name)
            case _:
                pass
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
        variable = given.variable if isinstance(given, syntax.Reference) else given
        if isinstance(variable, syntax.Variable) and variable.kind != parameter.kind:
            text = f"argument {number} of {name} is {variable.spelling}, "
            yield at(program, step, "P0138", f"{text}the parameter is {parameter.spelling}")


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
                case _:
                    pass

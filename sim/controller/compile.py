"""Compiler from programs to operations, one for each step."""

from collections.abc import Callable, Mapping
from functools import lru_cache

from sim.as_language import syntax as s
from sim.as_language.errors import AsError
from sim.as_language.syntax import Instruction, Program, ProgramStep, SourceFile
from sim.controller import instructions_motion, instructions_tasks, instructions_tcp, statements
from sim.controller.instruction import Action, compile_instruction
from sim.controller.tasks import Compiled, Op, Task

_STATEMENTS: dict[type, Callable[..., Op]] = {
    s.If: statements.compile_test,
    s.While: statements.compile_test,
    s.Until: statements.compile_test,
    s.For: statements.compile_for,
    s.End: statements.compile_end,
    s.CaseStatement: statements.compile_case,
    s.Goto: statements.compile_goto,
    s.Return: statements.compile_return,
    s.Assign: statements.compile_assign,
    s.PointStatement: statements.compile_point,
    s.Here: statements.compile_here,
    s.Decompose: statements.compile_decompose,
    s.CallStatement: statements.compile_call,
    s.Scall: statements.compile_scall,
    s.Print: statements.compile_print,
}
INSTRUCTIONS: Mapping[str, Action] = {
    **instructions_motion.INSTRUCTIONS,
    **instructions_tasks.INSTRUCTIONS,
    **instructions_tcp.INSTRUCTIONS,
}


@lru_cache(maxsize=8)
def compile_file(source: SourceFile) -> Mapping[str, Compiled]:
    """Return the compiled programs of a file; all machines share them."""
    return {name: _compile_program(p) for name, p in source.programs.items()}


def _compile_program(program: Program) -> Compiled:
    """Return a program that can be executed.

    A step that cannot be compiled does not reject the file: it fails when it is reached, as on the
    controller, with its code, program and step. Steps are compiled lazily when first reached, as
    half of a program never is.
    """
    ops: list[Op] = []
    for at, step in enumerate(program.steps):
        ops.append(_when_reached(step, at, ops))
    return Compiled(program, ops)


def _when_reached(step: ProgramStep, at: int, ops: list[Op]) -> Op:
    """Return an operation that compiles itself at the first call and then replaces itself."""
    op: Op | None = None

    def run(task: Task) -> int:
        nonlocal op
        if op is None:
            op = ops[at] = _compile(step, at)
        return op(task)

    return run


def _compile(step: ProgramStep, at: int) -> Op:
    statement = step.statement
    try:
        if isinstance(statement, s.Comment | s.Do):
            return statements.jump_to(at + 1)
        if isinstance(statement, s.Else | s.Value | s.Any):
            return statements.jump_to(statement.end_at)
        if not isinstance(statement, Instruction):
            return _STATEMENTS[type(statement)](statement, at)
        action = INSTRUCTIONS.get(statement.name)
        if action is not None:
            return compile_instruction(action, statement, at)
        known = "unknown" if statement.unknown else "not emulated"
        return statements.failing(AsError("E0111", f"{statement.name} is {known}"))
    except AsError as error:
        return statements.failing(error)

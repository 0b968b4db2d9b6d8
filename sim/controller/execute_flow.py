"""Control flow: IF, WHILE, FOR, DO, CASE, GOTO and RETURN."""

from collections.abc import Callable

from sim.as_language import syntax as s
from sim.as_language.errors import AsError
from sim.as_language.values import single
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler
from sim.controller.task import Task


def jump_to(at: int) -> Op:
    """Return an unconditional jump to a step."""
    return lambda _: at


def compile_if(statement: s.If, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile `IF condition THEN`."""
    return _unless(evaluate.truth(statement.condition), at + 1, statement.false_at)


def compile_while(statement: s.While, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile `WHILE condition DO`."""
    return _unless(evaluate.truth(statement.condition), at + 1, statement.after_at)


def compile_until(statement: s.Until, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile `UNTIL condition`."""
    return _unless(evaluate.truth(statement.condition), at + 1, statement.do_at)


def compile_goto(statement: s.Goto, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile GOTO; a missing label fails when it is executed (E0101)."""
    found = statement.target != s.UNRESOLVED
    jump = jump_to(statement.target) if found else _no_label(statement.label)
    if statement.condition is None:
        return jump
    condition = evaluate.truth(statement.condition)
    if found:
        return _unless(condition, statement.target, at + 1)
    return lambda task: jump(task) if condition(task) else at + 1


def compile_for(statement: s.For, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile FOR: stores the action of its END in the frame's `loops`."""
    assign, read = evaluate.store(statement.variable), evaluate.real(statement.variable)
    start, stop = evaluate.real(statement.start), evaluate.real(statement.stop)
    step, after = evaluate.real(statement.step), statement.after_at

    def run(task: Task) -> int:
        assign(task, start(task))
        last, by = stop(task), step(task)

        def test(task: Task) -> int:
            value = read(task)
            return at + 1 if (value <= last if by >= 0.0 else value >= last) else after

        def advance(task: Task) -> int:
            assign(task, single(read(task) + by))
            return test(task)

        task.frames[-1].loops[at] = advance
        return test(task)

    return run


def compile_end(statement: s.End, at: int, _: ArgumentCompiler) -> Op:
    """Compile END: jump to the top of a loop, otherwise to the next step."""
    start = statement.start_at
    if statement.of == "WHILE":
        return jump_to(start)
    if statement.of != "FOR":
        return jump_to(at + 1)

    def run(task: Task) -> int:
        advance = task.frames[-1].loops.get(start)
        if advance is None:
            raise AsError("P0141", "the loop was entered by GOTO, its FOR was not executed")
        return advance(task)

    return run


def compile_case(statement: s.CaseStatement, _: int, evaluate: ArgumentCompiler) -> Op:
    """Compile CASE and SCASE: the first branch that holds an equal value."""
    of = evaluate.text if statement.text else evaluate.real
    selector = of(statement.selector)
    branches = [
        (tuple(of(value) for value in branch.values), branch.body_at)
        for branch in statement.branches
    ]
    default = statement.default_at

    def run(task: Task) -> int:
        selected = selector(task)
        for values, body_at in branches:
            for value in values:
                if value(task) == selected:
                    return body_at
        return default

    return run


def compile_return(_: s.Return, at: int, __: ArgumentCompiler) -> Op:
    """Compile RETURN: return to the caller; in the main program it ends the cycle."""

    def run(task: Task) -> int:
        task.leave()
        return at

    return run


def _unless(condition: Callable[[Task], float], then: int, otherwise: int) -> Op:
    return lambda task: then if condition(task) else otherwise


def _no_label(label: str) -> Op:
    def run(_: Task) -> int:
        raise AsError("E0101", f"GOTO {label}")

    return run

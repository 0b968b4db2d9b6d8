"""PRINT and TYPE: output of one line."""

from sim.as_language.syntax import Print
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler
from sim.controller.task import Task


def compile_print(statement: Print, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile PRINT [device:] items and TYPE items; all devices share one output."""
    layout = evaluate.printed(statement.items)

    def run(task: Task) -> int:
        text, feed = layout(task)
        task.machine.print(text, feed=feed)
        return at + 1

    return run

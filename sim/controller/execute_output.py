"""PRINT and TYPE: one line to whoever listens."""

from sim.controller.compiled import Op
from sim.controller.context import Context
from sim.controller.syntax import Print
from sim.controller.task import Task


def compile_print(statement: Print, at: int, context: Context) -> Op:
    """Compile PRINT [device:] items and TYPE items; every device is the same listener."""
    layout, machine = context.evaluate.printed(statement.items), context.machine

    def run(task: Task) -> int:
        text, feed = layout(task)
        machine.print(text, feed=feed)
        return at + 1

    return run

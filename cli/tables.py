"""Printing of tables from which a user copies names: no word of them is cut."""

import sys

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

NO_LIMIT = 10_000  # columns of a file or a pipe, in which no line is broken


def table_console() -> Console:
    """Return a console of standard output."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else NO_LIMIT)


def print_table(console: Console, table: Table) -> None:
    """Print a table, wider than the terminal if its longest words need it."""
    options = console.options.update(width=NO_LIMIT)
    for column in table.columns:
        cells = (column.header, *column.cells)
        column.min_width = max(Measurement.get(console, options, cell).minimum for cell in cells)
    least = Measurement.get(console, options, table).minimum
    console.print(table, width=max(console.width, least), crop=False)

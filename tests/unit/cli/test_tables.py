"""Tables from which a user copies names."""

import io

import pytest
from rich.console import Console
from rich.table import Table

from cli.tables import print_table

NAME = "controller.server_monitor_speed_fraction_of_the_program"


@pytest.mark.parametrize("width", [20, 40, 80, 200])
def test_no_name_is_cut_on_a_narrow_terminal(width: int) -> None:
    """The line may exceed the terminal's width."""
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    table = Table("key", "value")
    table.add_row(NAME, "a text of several words that may be broken between them")
    print_table(console, table)
    printed = console.file.getvalue()  # type: ignore[attr-defined]
    assert NAME in printed
    assert "…" not in printed

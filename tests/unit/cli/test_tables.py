"""Tables from which a user copies names."""

import io

import pytest
from rich.console import Console
from rich.table import Table

from cli.tables import print_table, table_console

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


def test_into_a_pipe_no_line_is_broken(capsys: pytest.CaptureFixture[str]) -> None:
    """Each row is one line, so grep works."""
    table = Table("key", "value")
    table.add_row(NAME, "word " * 60)
    print_table(table_console(), table)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if NAME in line]
    assert line.count("word") == 60

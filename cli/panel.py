"""Verb `panel`: the panel of a cell in the browser; `up` and `demo` start it as a helper."""

from typing import Annotated

from typer import Option

from cli.context import CellOption, cell_of, find_cell_file, one_line_errors

WITHOUT_VARIABLE = "FORCEMESH_NO_PANEL"

NoPanel = Annotated[
    bool,
    Option("--no-panel", envvar=WITHOUT_VARIABLE, help="Do not start the browser panel."),
]


def panel(
    *,
    view_only: Annotated[bool, Option("--view-only", help="Read-only page: no actions.")] = False,
    open_: Annotated[bool, Option("--open", help="Open it in this machine's browser.")] = False,
    host: Annotated[
        str | None, Option(help="Listen address; any but this machine requires a token.")
    ] = None,
    port: Annotated[int | None, Option(min=1, max=65535, help="Listen port.")] = None,
    cell: CellOption = None,
) -> None:
    """Serve the panel of a cell in the browser: arm, plots, force, moves, calibration, faults."""
    path = find_cell_file(cell)
    with cell_of(path):
        pass  # reports a cell that is not up at once; a page would only wait for it
    arguments = ["--cell", str(path)]
    for name, value in (("--host", host), ("--port", port)):
        arguments += [name, str(value)] if value is not None else []
    arguments += ["--view-only"] if view_only else []
    arguments += ["--open"] if open_ else []
    with one_line_errors():
        from services.panel.__main__ import main

        main(arguments)

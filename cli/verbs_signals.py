"""Verbs for digital signals of the controller: signals list, set, wait."""

import json
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Option, Typer, echo

from cli.context import CellOption, JsonOption, cell_of, one_line_errors, print_reply
from forcemesh.messages import Asker

if TYPE_CHECKING:
    from common.config.signals import SignalSection

signals = Typer(no_args_is_help=True, help="Digital inputs and outputs that the cell file names.")

StateArgument = Annotated[Literal["on", "off"], Argument(metavar="STATE", help="on or off.")]


@signals.command("list")
def list_signals(as_json: JsonOption = False, cell: CellOption = None) -> None:
    """List the signals with their state, and who may set them."""
    with cell_of(cell) as client:
        on, named = client.signals.read(), client.config.signals
    if as_json:
        print(json.dumps(on))
        return
    from rich.table import Table

    from cli.tables import print_table, table_console

    table = Table("signal", "number", "state", "set by", "while held")
    for name, state in on.items():
        table.add_row(name, *_cells(named.get(name), on=state))
    print_table(table_console(), table)


def _cells(signal: "SignalSection | None", *, on: bool) -> tuple[str, str, str, str]:
    """Return number, state, who may set it, and whether while held, as texts.

    Args:
        signal: Of the cell file; None where the file on this PC does not name it.
        on: Present state.
    """
    state = "on" if on else "off"
    if signal is None:
        return "-", state, "-", "-"
    return (
        signal.label,
        state,
        ", ".join(signal.set_by) or "-",
        "yes" if signal.while_held else "no",
    )


@signals.command("set")
def set_signal(
    signal: Annotated[str, Argument(metavar="SIGNAL", help="Its name, or its number.")],
    state: StateArgument,
    *,
    commander: Annotated[Asker, Option("--as", help="Commander that set_by permits.")] = "operator",
    cell: CellOption = None,
) -> None:
    """Switch an output; refused if the cell file does not name it or does not permit it."""
    from forcemesh import topics
    from forcemesh.client.ask import request_in_bounds
    from forcemesh.client.signals import SWITCHED_WITHIN_S
    from forcemesh.requests import SignalRequest

    request = SignalRequest(signal=signal, on=state == "on", commander=commander)
    with one_line_errors():
        request_in_bounds(request)
    with cell_of(cell) as client:
        print_reply(client.ask(topics.SIGNAL, request, within_s=SWITCHED_WITHIN_S))


@signals.command("wait")
def wait_for_signal(
    signal: Annotated[str, Argument(metavar="SIGNAL", help="Its name.")],
    state: StateArgument = "on",
    *,
    timeout: Annotated[
        float, Option("--timeout", min=0.1, max=86_400.0, help="Longest wait [s].")
    ] = 60.0,
    cell: CellOption = None,
) -> None:
    """Wait until a signal is on or off; exit code 1 when it is not in time."""
    with cell_of(cell) as client:
        client.signals.wait(signal, state == "on", timeout)
    echo(f"{signal} is {state}")

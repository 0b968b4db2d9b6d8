"""Read-only verbs: status, topics."""

import json
from typing import TYPE_CHECKING, Annotated, Any

from typer import Exit, Option

from cli.context import (
    NOT_WELL,
    OK,
    CellOption,
    JsonOption,
    exit_with_error,
    find_cell_file,
    live_cell,
    one_line_errors,
)
from forcemesh.faults import trip_text
from forcemesh.messages import Trip
from forcemesh.topics import HELPERS, REQUESTS, ROLES, TOPICS
from services.panel.state_colours import NO_STATE, STATE_COLOURS

if TYPE_CHECKING:
    from cli.status import CellStatus
    from common.config.cell import CellConfig


def status(
    as_json: JsonOption = False,
    service: Annotated[
        str | None,
        Option(metavar="NAME", help="Only report whether this role is alive (for health checks)."),
    ] = None,
    cell: CellOption = None,
) -> None:
    """Show the state of a cell and of its processes; exit code 0 only without faults.

    A requested hold is not a fault; a hold by a limit is one until it is cleared.
    The recorder is included if it publishes its health or was started by `up`.
    """
    with one_line_errors():
        from cli.status import cell_status, exit_code
        from launch.run_file import read_run

        names = (*ROLES, *HELPERS)
        if service is not None and service not in names:
            exit_with_error(f"unknown role {service!r}: choose from {', '.join(names)}")
        loaded = live_cell(cell, ended=True)
        found = cell_status(loaded, read_run(loaded.cell), only=service)
    if service is not None:
        row = next(row for row in found["services"] if row["name"] == service)
        line = f"{service}: {'alive' if row['alive'] else row['fault']}"
        print(json.dumps(row) if as_json else line)
        raise Exit(OK if row["alive"] else NOT_WELL)
    if as_json:
        print(json.dumps(found))
    else:
        _print_status(found)
    raise Exit(exit_code(found))


def topics(
    as_json: JsonOption = False,
    schema: Annotated[
        bool,
        Option("--schema", help="JSON Schema of every topic and request; needs no cell."),
    ] = False,
    cell: CellOption = None,
) -> None:
    """List every topic and request of the bus: writer, rate, stale time."""
    if schema:
        from forcemesh.schema import describe

        print(json.dumps(describe(), indent=2))
        return
    with one_line_errors():
        from common.config.load import load_cell

        loaded = load_cell(find_cell_file(cell))
    if as_json:
        print(json.dumps(_bus_table(loaded)))
    else:
        _print_bus_table(loaded)


def _print_status(found: "CellStatus") -> None:
    from rich.table import Table

    from cli.arm_readings import reading_lines
    from cli.status import FOR_PROGRAMS, describe_number, died_text
    from cli.tables import print_table, table_console

    state = found["state"]
    colour = STATE_COLOURS.get(state, NO_STATE)
    console = table_console()
    was = f" (was {found['last_state']})" if state == "DOWN" and found["last_state"] else ""
    console.print(
        f"cell [bold]{found['cell']}[/bold]: "
        f"[bold {colour.text} on {colour.background}]{state}[/]{was}, "
        f"commander {found['commander']}",
        soft_wrap=True,
    )
    for label, lines in (
        ("stopped by", [trip_text(Trip.from_dict(trip)) for trip in found["trips"]]),
        ("not ready", found["not_ready"]),
        ("died", [died_text(each) for each in found["restarts"]]),
        ("next", [found["clears"]] if found["clears"] else []),
        *((label, [text]) for label, text in reading_lines(found["arm"])),
    ):
        for line in lines:
            console.print(f"  {label:<12} {line}", markup=False, soft_wrap=True)
    table = Table("role", "pid", "alive", "loop", "processor", "age", "fault")
    for row in found["services"]:
        table.add_row(
            row["name"],
            str(row["pid"] or "-"),
            "[green]yes[/]" if row["alive"] else "[red]no[/]",
            "-" if row["rate_hz"] is None else f"{row['rate_hz']:.1f} Hz",
            f"{100.0 * used:.0f} %" if (used := row["numbers"].get("processor_fraction")) else "-",
            "-" if row["age_s"] is None else f"{1e3 * row['age_s']:.0f} ms",
            row["fault"],
        )
    print_table(console, table)
    for row in found["services"]:
        if row["late"]:
            console.print(f"  {row['name']}: {row['late']}", markup=False, soft_wrap=True)
        shown = sorted(item for item in row["numbers"].items() if item[0] not in FOR_PROGRAMS)
        if shown:
            text = ", ".join(describe_number(*item) for item in shown)
            console.print(f"  {row['name']}: {text}", markup=False, soft_wrap=True)


def _bus_table(cell: "CellConfig") -> dict[str, Any]:
    """Return topics and requests with the rates of a cell, as a dict for JSON."""
    return {
        "cell": cell.cell,
        "topics": [
            {
                "topic": topic.key,
                "key": f"{cell.cell}/{topic.key}",
                "message": topic.message.__name__,
                "writer": topic.writer,
                "readers": list(topic.readers),
                "rate_hz": cell.rate_hz(topic),
                "stale_after_s": cell.stale_after_s(topic),
                "qos": topic.qos,
                "summary": topic.summary,
            }
            for topic in TOPICS
        ],
        "requests": [
            {
                "request": request.key,
                "key": f"{cell.cell}/{request.key}",
                "message": request.message.__name__,
                "server": request.server,
                "summary": request.summary,
            }
            for request in REQUESTS
        ],
    }


def _print_bus_table(cell: "CellConfig") -> None:
    """Print the table on the terminal."""
    from rich.table import Table

    from cli.tables import print_table, table_console

    topics = Table("topic", "writer", "readers", "rate", "stale after", "summary", title="topics")
    for topic in TOPICS:
        topics.add_row(
            topic.key,
            topic.writer,
            ", ".join(topic.readers),
            f"{cell.rate_hz(topic):g} Hz",
            f"{1e3 * cell.stale_after_s(topic):.0f} ms",
            topic.summary,
        )
    requests = Table("request", "server", "summary", title="requests")
    for request in REQUESTS:
        requests.add_row(request.key, request.server, request.summary)
    console = table_console()
    console.print(f"every key has the prefix [bold]{cell.cell}/[/bold]")
    print_table(console, topics)
    print_table(console, requests)

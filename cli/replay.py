"""Verb `replay`: publishes a recording again with the same bytes and timing."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option

from cli.context import REFUSED, exit_with_error, one_line_errors, print_note
from forcemesh.topics import CLIENT, TOPICS

if TYPE_CHECKING:
    from common.config.cell import CellConfig
    from forcemesh.bus import Bus
    from services.recorder.reading import RecordedFile

REPLAY_LISTEN_S = 1.5  # the slowest topic of a cell that is alive comes four times a second
REPLAY_TICK_S = 0.02
REPLAY_QUEUE = 4

RecordingArgument = Annotated[
    Path, Argument(metavar="FILE", help="A recording, as `forcemesh record` writes it.")
]
OnlyOption = Annotated[
    list[str] | None,
    Option("--only", metavar="TOPIC", help="Only this topic; repeatable."),
]


def replay(
    file: RecordingArgument,
    *,
    only: OnlyOption = None,
    speed: Annotated[
        float, Option(min=0.01, max=100.0, help="Factor of the original speed.")
    ] = 1.0,
    port: Annotated[
        int | None,
        Option(min=1, max=65535, help="Port of its own hub; default: a free port."),
    ] = None,
    onto: Annotated[
        Path | None,
        Option(metavar="CELL", help="Use the hub of this cell file instead of its own hub."),
    ] = None,
    name: Annotated[
        str | None, Option("--as", metavar="NAME", help="Publish under another cell name.")
    ] = None,
    wait: Annotated[
        float,
        Option(min=0.0, max=3600.0, help="Delay before the start [s]: time to connect."),
    ] = 0.0,
    to_service: Annotated[
        str | None,
        Option(
            metavar="ROLES",
            help="Play inputs and requests through these services, in this process, and compare "
            "their output: wrench, regulator, arbiter, several with commas, or cell for the last "
            "two. Exit code 1 when it differs.",
        ),
    ] = None,
) -> None:
    """Replay a recording: publish the same bytes in the same order and time.

    It starts its own hub and never publishes to a running cell.
    """
    with one_line_errors():
        from services.recorder.reading import RecordedFile

        topics = chosen_topics(only)
        read = RecordedFile(file)
        cell = recorded_cell(read)
        if to_service is not None:
            from cli.replay_service import replay_to_service

            replay_to_service(read, cell, to_service)
            return
        if name is not None:
            from common.config.load import cell_from_tree

            cell = cell_from_tree(cell.model_dump() | {"cell": name}, "--as")
        try:
            with _bus_of(cell, port=port, onto=onto, topics=topics) as bus:
                _play_recording(read, bus, topics, speed=speed, wait_s=wait)
        except KeyboardInterrupt:
            raise Exit(0) from None


def chosen_topics(only: list[str] | None) -> frozenset[str]:
    """Return the named topics; an unknown one ends the verb."""
    from cli.verbs_watch import find_topic

    return frozenset(find_topic(topic).key for topic in only or ())


def recorded_cell(read: "RecordedFile") -> "CellConfig":
    """Return the cell of a recording."""
    if read.cell is None:
        version_text = f"recorded by version {read.about.get('version', 'unknown')}"
        exit_with_error(
            f"{read.path}: this version cannot read the cell file in it: {version_text}"
        )
    return read.cell


@contextmanager
def _bus_of(
    cell: "CellConfig", *, port: int | None, onto: Path | None, topics: frozenset[str]
) -> "Iterator[Bus]":
    """Open an own hub, or connect to another one if no cell is running there."""
    from common.bus.cell_bus import open_bus, open_hub
    from common.config.load import dump_cell, load_cell
    from forcemesh.zenoh_settings import ENDPOINT_VARIABLE

    if onto is not None:
        target_cell = load_cell(onto)
        host = cell.model_copy(update={"bus": target_cell.bus})
        with open_bus(host, CLIENT, patience_s=1.0) as bus:
            _refuse_if_alive(bus, topics)
            yield bus
        return
    from launch.run_file import writable_folder, write_atomically

    endpoint = f"tcp/127.0.0.1:{port or free_port()}"
    own_bus = cell.bus.model_copy(update={"endpoint": endpoint, "upstream": None, "tls": None})
    host = cell.model_copy(update={"bus": own_bus})
    os.environ[ENDPOINT_VARIABLE] = endpoint
    path = writable_folder() / f"replay-{cell.cell}.yaml"
    write_atomically(path, dump_cell(host))
    try:
        with open_hub(host) as bus:
            print_note(f"hub at {endpoint}; connect with --cell {path}")
            yield bus
    finally:
        path.unlink(missing_ok=True)


def _refuse_if_alive(bus: "Bus", topics: frozenset[str]) -> None:
    """End the verb when a topic already has a publisher: two writers are a fault."""
    import time

    chosen = [topic for topic in TOPICS if not topics or topic.key in topics]
    taps = {topic.key: bus.tap(topic, REPLAY_QUEUE) for topic in chosen}
    give_up_s = time.monotonic() + REPLAY_LISTEN_S
    while time.monotonic() < give_up_s:
        published = [key for key, tap in taps.items() if tap.take() is not None]
        if published:
            exit_with_error(
                f"refused: a cell {bus.cell} is running there and publishes "
                f"{', '.join(published)}; choose another name with --as, or omit --onto",
                REFUSED,
            )
        time.sleep(REPLAY_TICK_S)


def _play_recording(
    read: "RecordedFile", bus: "Bus", topics: frozenset[str], *, speed: float, wait_s: float
) -> None:
    from rich.console import Console
    from rich.progress import Progress, TextColumn, TimeElapsedColumn

    from services.recorder.reading import play

    bus.clock.sleep_s(wait_s)
    columns = (TextColumn("{task.description}"), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("replaying")

        def shown(count: int, at_s: float) -> None:
            if count % 500 == 0:
                bar.update(task, description=f"{at_s:.1f} s replayed, {count} messages")

        messages = (each for each in read.raw_messages() if not topics or each.topic in topics)
        count = play(messages, bus.transport, bus.cell, clock=bus.clock, speed=speed, shown=shown)
    truncation = "" if read.is_whole else "; the file is truncated: its recorder was killed"
    print_note(f"{count} messages replayed{truncation}")


def free_port() -> int:
    """Return a port of this machine that no program uses."""
    import socket

    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])

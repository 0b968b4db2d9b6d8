"""Measure what the documentation states: `make bench`, or one part: `python -m bench emulator`."""

import argparse
from collections.abc import Callable

from rich.console import Console
from rich.table import Table

from bench import (
    demos,
    emulator,
    faults,
    installations,
    panel,
    physics,
    recorder,
    sensor_faults,
    settling,
    stalls,
    steps,
    subscriptions,
)

PARTS: dict[str, Callable[[], Table]] = {
    "settling": settling.table,
    "emulator": emulator.table,
    "pace": emulator.pace_table,
    "faults": faults.table,
    "sensor-faults": sensor_faults.table,
    "physics": physics.table,
    "installations": installations.table,
    "panel": panel.table,
    "recorder": recorder.table,
    "subscriptions": subscriptions.table,
    "stalls": stalls.table,
    "demos": demos.table,
    "steps": steps.table,
    "instructions": steps.instructions_table,
    "virtual": steps.virtual_table,
}
WRITERS: dict[str, Callable[[], None]] = {
    "settling": settling.write,
    "stalls": stalls.write,
    "demos": demos.write,
}
ON_REQUEST = {
    "demos",
    "installations",
    "instructions",
    "panel",
    "recorder",
    "stalls",
    "subscriptions",
}  # long, or with a browser


def main() -> None:
    """Print the requested tables, by default all but the longest."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--write", action="store_true",
                        help=f"write it into its page: {', '.join(WRITERS)}")  # fmt: skip
    given = parser.parse_args()
    requested = given.parts or [part for part in PARTS if part not in ON_REQUEST]
    unknown = [part for part in requested if part not in PARTS]
    if unknown:
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    if given.write and not set(requested) <= WRITERS.keys():
        parser.error(f"--write is for {', '.join(WRITERS)}")
    screen = Console()
    for part in requested:
        if given.write:
            WRITERS[part]()
        else:
            screen.print(PARTS[part]())


if __name__ == "__main__":
    main()

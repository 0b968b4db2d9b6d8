"""Measure what the documentation states: `make bench`, or one part: `python -m bench faults`."""

import argparse
from collections.abc import Callable

from rich.console import Console
from rich.table import Table

from bench import (
    demos,
    faults,
    installations,
    recorder,
    sensor_faults,
    settling,
    stalls,
)

PARTS: dict[str, Callable[[], Table]] = {
    "settling": settling.table,
    "faults": faults.table,
    "sensor-faults": sensor_faults.table,
    "installations": installations.table,
    "recorder": recorder.table,
    "stalls": stalls.table,
    "demos": demos.table,
}
WRITERS: dict[str, Callable[[], None]] = {
    "settling": settling.write,
    "stalls": stalls.write,
    "demos": demos.write,
}
ON_REQUEST = {
    "demos",
    "installations",
    "recorder",
    "stalls",
}  # long


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

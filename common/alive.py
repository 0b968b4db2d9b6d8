"""The healthcheck of a container: whether one role does its work in time, by its own word.

`python -m common.alive --cell FILE --role NAME`: exit code 0 while the role's health is fresh on
the bus and names no fault. A process that hangs, is late or has lost the hub is not fresh.
"""

import argparse
import sys
import time

from common.bus import open_bus
from common.cell import Cell
from common.config import load_cell
from common.errors import ForcemeshError
from common.topics import CLIENT, EVERY_HEALTH

CONNECT_WITHIN_S = 1.0
POLL_S = 0.02


def complaint(cell: Cell, role: str) -> str:
    """Return why a role is not well, empty when it is.

    Raises:
        ForcemeshError: The hub does not answer, or there is no certificate for asking it.
    """
    with open_bus(cell, CLIENT, patience_s=CONNECT_WITHIN_S) as bus:
        health = bus.reader(EVERY_HEALTH[role])
        give_up_s = time.monotonic() + 2 * health.stale_after_s
        while True:
            reading = health.read(bus.clock.now_ns())
            if reading.fresh is not None:
                return reading.fresh.fault
            if time.monotonic() >= give_up_s:
                return reading.fault
            time.sleep(POLL_S)


def main() -> int:
    """Ask, say what is wrong, return the exit code."""
    parser = argparse.ArgumentParser(prog="common.alive", description=__doc__)
    parser.add_argument("--cell", required=True, metavar="FILE")
    parser.add_argument("--role", required=True, choices=tuple(EVERY_HEALTH))
    given = parser.parse_args()
    try:
        said = complaint(load_cell(given.cell), given.role)
    except ForcemeshError as error:
        said = str(error)
    sys.stdout.write(f"{said or given.role + ' is well'}\n")
    return 1 if said else 0


if __name__ == "__main__":
    sys.exit(main())

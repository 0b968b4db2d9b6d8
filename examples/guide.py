"""Hand guiding for ten seconds, then the return path through the recorded positions.

Guide the tool by hand: it yields to a push, and stays where it is released. Start in free space.
This is not a safety function: keep a hand on the emergency stop.
"""

import math
import sys

from forcemesh import ArmStoppedError, Cell, ForcemeshError
from forcemesh.messages import PoseRecord

SECONDS = 10.0
EVERY_M = 0.01  # distance between recorded positions


def record_guiding(cell: Cell, seconds: float) -> list[PoseRecord]:
    """Run hand guiding for a time; return the recorded poses of the flange."""
    places = [here(cell)]
    cell.force.guide()
    try:
        for _ in cell.state.stream(seconds=seconds):
            if not cell.status().operational:
                raise ArmStoppedError("hold", "the arm was stopped")
            if math.dist(here(cell).position_m, places[-1].position_m) > EVERY_M:
                places.append(here(cell))
    finally:
        cell.force.stop()
    return places


def here(cell: Cell) -> PoseRecord:
    """Return the pose of the flange in base."""
    state = cell.state()
    return PoseRecord(position_m=state.position_m, orientation_xyzw=state.orientation_xyzw)


def main(cell: Cell, seconds: float = SECONDS) -> int:
    """Guide, then return; return the number of recorded poses."""
    print(f"guide the tool by hand, {seconds:g} s")
    places = record_guiding(cell, seconds)
    print(f"returning through {len(places)} positions")
    for place in reversed(places):
        cell.move.to(place.position_m, place.orientation_xyzw, speed_m_s=0.05)
    return len(places)


if __name__ == "__main__":
    try:
        with Cell(sys.argv[1] if len(sys.argv) > 1 else "cells/demo.yaml") as the_cell:
            main(the_cell)
    except ForcemeshError as error:  # one sentence: the error and the remedy
        sys.exit(str(error))

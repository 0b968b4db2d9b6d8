"""Follow a hand for ten seconds, then go the way back, from place to place.

Lead the tool by hand: it gives way to a push, and stays where it is left. Begin in free air. This
is not a safety function: keep a hand at the emergency stop.
"""

import math
import sys

from forcemesh import ArmStoppedError, Cell, ForcemeshError
from forcemesh.messages import PoseRecord

SECONDS = 10.0
EVERY_M = 0.01  # apart: the places that are remembered


def lead(cell: Cell, seconds: float) -> list[PoseRecord]:
    """Give way to a hand for a while; return where the flange has been."""
    places = [here(cell)]
    cell.force.start(law="guide")
    try:
        for _ in cell.state.stream(seconds=seconds):
            if not cell.status().goes_on:
                raise ArmStoppedError("hold", "the arm was stopped")
            if math.dist(here(cell).position_m, places[-1].position_m) > EVERY_M:
                places.append(here(cell))
    finally:
        cell.force.stop()
    return places


def here(cell: Cell) -> PoseRecord:
    """Return where the flange is, in base."""
    state = cell.state()
    return PoseRecord(position_m=state.position_m, orientation_xyzw=state.orientation_xyzw)


def main(cell: Cell, seconds: float = SECONDS) -> int:
    """Be led, go back; return how many places were gone to."""
    print(f"lead the tool by hand, {seconds:g} s")
    places = lead(cell, seconds)
    print(f"going back along {len(places)} places")
    for place in reversed(places):
        cell.move.to(place.position_m, place.orientation_xyzw, speed_m_s=0.05)
    return len(places)


if __name__ == "__main__":
    try:
        with Cell(sys.argv[1] if len(sys.argv) > 1 else "cells/demo.yaml") as the_cell:
            main(the_cell)
    except ForcemeshError as error:  # one sentence that says what is wrong and what to do
        sys.exit(str(error))

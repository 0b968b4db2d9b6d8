"""Find a surface: approach along the tool's axis until contact, then retract 2 mm."""

import sys

from forcemesh import Cell, ForcemeshError, NotReachedError

FORCE_N = 5.0  # set point of the approach, which is stopped at contact
BACK_M = 0.002
WITHIN_S = 60.0


def main(cell: Cell) -> tuple[float, float, float]:
    """Touch and retract; return the position of the flange at contact [m]."""
    cell.force.start(FORCE_N)
    try:
        for reading in cell.target.stream(seconds=WITHIN_S):
            if reading.message.contact == "contact":
                break
            if not (status := cell.status()).operational:
                why = "; ".join(trip.text for trip in status.trips)
                raise NotReachedError(f"the arm was stopped before contact: {why}")
        else:
            raise NotReachedError(f"no contact within {WITHIN_S:g} s")
        place = cell.state().position_m
    finally:
        cell.force.stop()
    x, y, z = (1e3 * part for part in place)
    print(f"contact with the flange at {x:.2f}, {y:.2f}, {z:.2f} mm")
    cell.jog(shift_m=(0.0, 0.0, -BACK_M), axes="tool", speed_m_s=0.02)
    return place


if __name__ == "__main__":
    try:
        with Cell(sys.argv[1] if len(sys.argv) > 1 else "cells/demo.yaml") as the_cell:
            main(the_cell)
    except ForcemeshError as error:  # one sentence: the error and the remedy
        sys.exit(str(error))

"""Find a surface: approach along the tool's axis until something pushes back, then go back 2 mm."""

import sys

from forcemesh import Cell, ForcemeshError, NotReachedError

FORCE_N = 5.0  # the approach would go on to this, if it were not stopped at the touch
BACK_M = 0.002
WITHIN_S = 60.0


def main(cell: Cell) -> tuple[float, float, float]:
    """Touch, go back, return where the flange was at the touch [m]."""
    cell.force.start(FORCE_N)
    try:
        for said in cell.target.stream(seconds=WITHIN_S):
            if said.message.contact == "contact":
                break
            if not (status := cell.status()).goes_on:
                why = "; ".join(trip.text for trip in status.trips)
                raise NotReachedError(f"the arm was stopped on its way: {why}")
        else:
            raise NotReachedError(f"nothing was touched within {WITHIN_S:g} s")
        place = cell.state().position_m
    finally:
        cell.force.stop()
    x, y, z = (1e3 * part for part in place)
    print(f"touched with the flange at {x:.2f}, {y:.2f}, {z:.2f} mm")
    cell.jog(shift_m=(0.0, 0.0, -BACK_M), axes="tool", speed_m_s=0.02)
    return place


if __name__ == "__main__":
    try:
        with Cell(sys.argv[1] if len(sys.argv) > 1 else "cells/demo.yaml") as the_cell:
            main(the_cell)
    except ForcemeshError as error:  # one sentence that says what is wrong and what to do
        sys.exit(str(error))

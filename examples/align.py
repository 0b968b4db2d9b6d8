"""Face alignment: press with 10 N and rotate about the TCP until the torque is zero."""

import math
import sys

from forcemesh import Cell, ForcemeshError, NotReachedError
from forcemesh.client.rotations import inverse, times

FORCE_N = 10.0
NO_TORQUE_NM = 0.1
STEADY_S = 0.3
WITHIN_S = 30.0


def main(cell: Cell) -> float:
    """Align and stop; return the rotation of the tool [degrees]."""
    before = cell.state().orientation_xyzw
    cell.force.start(FORCE_N, mode="both")
    flat_since_s = math.inf
    try:
        for received in cell.wrench.stream(seconds=WITHIN_S):
            if not cell.status().operational:
                raise NotReachedError("the arm was stopped")
            rests = math.hypot(*received.message.torque_Nm) <= NO_TORQUE_NM
            pressed = abs(cell.force.pressed_N() - FORCE_N) <= 1.0
            flat_since_s = min(flat_since_s, received.stamp_s) if rests and pressed else math.inf
            if received.stamp_s - flat_since_s >= STEADY_S:
                break
        else:
            raise NotReachedError(f"the torque was not zero after {WITHIN_S:g} s")
    finally:
        cell.force.stop()
    x, y, z, w = times(cell.state().orientation_xyzw, inverse(before))
    turned_deg = 2.0 * math.degrees(math.atan2(math.hypot(x, y, z), abs(w)))
    print(f"aligned, rotated by {turned_deg:.2f} degrees")
    return turned_deg


if __name__ == "__main__":
    try:
        with Cell(sys.argv[1] if len(sys.argv) > 1 else "cells/demo.yaml") as the_cell:
            main(the_cell)
    except ForcemeshError as error:  # one sentence: the error and the remedy
        sys.exit(str(error))

"""Press with 10 N for two seconds; print mean force and ripple."""

import statistics
import sys

from forcemesh import Cell, ForcemeshError

FORCE_N = 10.0
HOLD_S = 2.0


def main(cell: Cell, hold_s: float = HOLD_S) -> float:
    """Press, hold, stop; return the mean force [N]."""
    pressed = cell.force.press(FORCE_N)
    print(f"{pressed.force_N:.1f} N after {pressed.took_s:.2f} s, approach included")
    try:
        forces = [cell.force.pressed_N() for _ in cell.wrench.stream(seconds=hold_s)]
    finally:
        cell.force.stop()
    mean_N, ripple_N = statistics.fmean(forces), statistics.pstdev(forces)
    print(f"held {mean_N:.2f} N with a ripple of {ripple_N:.2f} N")
    return mean_N


if __name__ == "__main__":
    try:
        with Cell(sys.argv[1] if len(sys.argv) > 1 else "cells/demo.yaml") as the_cell:
            main(the_cell)
    except ForcemeshError as error:  # one sentence: the error and the remedy
        sys.exit(str(error))

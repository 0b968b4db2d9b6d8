"""Path with force: hold 8 N along the tool's axis while moving along a square across it."""

import sys

from forcemesh import Cell, ForcemeshError, NotReachedError
from forcemesh.client.rotations import plus, rotate
from forcemesh.messages import Vec3
from forcemesh.requests import ForceStartRequest

FORCE_N = 8.0
SIDE_M = 0.015
SPEED_M_S = 0.02
ALONG_TOOL = (False, False, True, False, False, False)


def tcp(cell: Cell) -> Vec3:
    """Return the position of the TCP in base [m]."""
    state, lever = cell.state(), cell.info.T_flange_tcp.position_m
    return plus(state.position_m, rotate(state.orientation_xyzw, lever))


def square(cell: Cell, side_m: float) -> tuple[Vec3, ...]:
    """Return the corners in the tool's plane, starting and ending at the present position."""
    q_flange_tool = cell.info.T_flange_tcp.orientation_xyzw
    start, q_base_flange = tcp(cell), cell.state().orientation_xyzw
    corners = ((side_m, 0.0, 0.0), (side_m, side_m, 0.0), (0.0, side_m, 0.0), (0.0, 0.0, 0.0))
    return tuple(
        plus(start, rotate(q_base_flange, rotate(q_flange_tool, corner))) for corner in corners
    )


def main(cell: Cell, side_m: float = SIDE_M) -> float:
    """Press, follow the square, stop; return the largest force error on the path [N]."""
    request = ForceStartRequest(
        mode="position", setpoint_N=FORCE_N, law="adaptive", axes=ALONG_TOOL, frame="tool"
    )
    worst_N = 0.0
    cell.force.begin(request)
    try:
        cell.force.settle()
        cell.force.path(square(cell, side_m), speed_m_s=SPEED_M_S)
        has_begun = False
        for reading in cell.target.stream(seconds=60.0):
            if reading.message.path_left_m is None or not cell.status().operational:
                raise NotReachedError(f"the path ended early: {reading.message.reason}")
            worst_N = max(worst_N, abs(cell.force.pressed_N() - FORCE_N))
            has_begun = has_begun or reading.message.path_left_m > 0.0
            if has_begun and reading.message.path_left_m < 1e-5:
                break
    finally:
        cell.force.stop()
    print(f"{4e3 * side_m:.0f} mm with {FORCE_N:g} N, force error at most {worst_N:.2f} N")
    return worst_N


if __name__ == "__main__":
    try:
        with Cell(sys.argv[1] if len(sys.argv) > 1 else "cells/demo.yaml") as the_cell:
            main(the_cell)
    except ForcemeshError as error:  # one sentence: the error and the remedy
        sys.exit(str(error))

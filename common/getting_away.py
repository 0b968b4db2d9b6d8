"""How an arm gets away from too much force: what it feels may only become less. Pure.

An arm that stands above its ceilings of force could never be armed again. Armed for jog it may
move, out of what pushes it and nowhere else, under ceilings that come down with what is felt.
"""

from dataclasses import replace

import numpy as np

from common.frames import Array
from common.limits import Limits, check_wrench
from common.messages import Trip

EASE = 1.05  # above what is felt: noise, and how a way out begins
LEAST_COSINE = 0.7  # of the angle between a way out and the force that pushes there


def eased(limits: Limits, force_N: Array, torque_Nm: Array, now: Limits | None = None) -> Limits:
    """Return limits with ceilings just above what is felt, where that is above the cell's.

    Args:
        limits: The cell's.
        force_N: Force of the environment on the tool, base axes. Shape (3,).
        torque_Nm: Torque about the TCP, base axes. Shape (3,).
        now: The eased limits so far; they never rise again.
    """
    force = max(limits.force_N, EASE * float(np.linalg.norm(force_N)))
    torque = max(limits.torque_Nm, EASE * float(np.linalg.norm(torque_Nm)))
    if now is not None:
        force, torque = min(force, now.force_N), min(torque, now.torque_Nm)
    return replace(limits, force_N=force, torque_Nm=torque)


def check_way_out(
    limits: Limits, force_N: Array, torque_Nm: Array, way_m: Array | None
) -> Trip | None:
    """Refuse a move that does not lead out of too much force.

    Args:
        limits: The cell's.
        force_N: As `eased`.
        torque_Nm: As `eased`.
        way_m: From the TCP to where it is to go, base axes, shape (3,); None where nobody knows.
    """
    trip = check_wrench(limits, force_N, torque_Nm)
    if trip is None:
        return None
    if way_m is None:
        text = f"{trip.text}: only a move to a pose, out of the contact, is let through"
        return trip.model_copy(update={"text": text})
    pushed_m = float(way_m @ force_N)
    if pushed_m > LEAST_COSINE * float(np.linalg.norm(way_m) * np.linalg.norm(force_N)):
        return None
    x, y, z = (round(float(part), 1) for part in force_N)
    text = f"{trip.text} and pushes along ({x}, {y}, {z}) N in base axes: go there first"
    return trip.model_copy(update={"text": text})

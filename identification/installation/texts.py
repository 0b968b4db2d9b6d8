"""Texts of wrong sensor axes and of the remedy in cell file or driver. Pure."""

import math

import numpy as np

from common.motion.frames import (
    Array,
    Oat,
    R_from_oat,
    oat_from_R,
    rotation_from_vector,
    vector_from_rotation,
)
from identification.installation.axis_fit import turn_angle

AXES = "xyz"
RESEMBLES_RAD = math.radians(5.0)
NEARLY_UPRIGHT = math.sin(math.radians(2.0))


def wrong_channels(wiring: Array, of: str) -> str:
    """Return the axis that each wrong channel shows, as "Fx shows -y"; `of` is F or M."""
    parts = []
    for row, channel in enumerate(AXES):
        axis = int(np.argmax(np.abs(wiring[row])))
        sign = "+" if wiring[row, axis] > 0.0 else "-"
        if axis != row or sign == "-":
            parts.append(f"{of}{channel} shows {sign}{AXES[axis]}")
    return ", ".join(parts)


def rotation_text(R: Array) -> str:
    """Return a rotation as "90 degrees about z"."""
    angle, axis = math.degrees(turn_angle(R)), vector_from_rotation(R)
    axis = axis / np.linalg.norm(axis)
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > 0.99:
        sign = "" if axis[largest] > 0.0 else "-"
        return f"{angle:.0f} degrees about {sign}{AXES[largest]}"
    return f"{angle:.0f} degrees about ({', '.join(f'{part:.2f}' for part in axis)})"


def oat_text(R_flange_sensor: Array) -> str:
    """Return an orientation in the format of the cell file, to a tenth of a degree."""
    R = R_flange_sensor
    tilt = math.hypot(R[0, 2], R[1, 2])
    if 0.0 < tilt < NEARLY_UPRIGHT:  # O and T are degenerate here: only their sum is known
        axis = np.cross(R[:, 2], [0.0, 0.0, math.copysign(1.0, R[2, 2])])
        R = rotation_from_vector(axis * (math.asin(tilt) / tilt)) @ R
    oat = [math.degrees(angle) for angle in oat_from_R(R)]
    rounded = [f"{round(angle, 1) + 0.0:g}" for angle in oat]
    return f"sensor.T_flange_sensor.oat_deg: [{', '.join(rounded)}]"


def is_in_radians(oat_deg: tuple[float, float, float], R_flange_sensor: Array) -> bool:
    """Return whether the angles of the cell file, taken as radians, match the readings."""
    small = max(abs(angle) for angle in oat_deg) <= math.tau + 0.01
    as_radians = R_from_oat(Oat(*oat_deg))
    return small and turn_angle(as_radians.T @ R_flange_sensor) < RESEMBLES_RAD


def driver_remedy(wiring: Array, of: str) -> str:
    """Return the remedy in the driver or the adapter as text.

    Args:
        wiring: Signed permutation: axis that each channel shows. Shape (3, 3).
        of: "F" or "M" for three channels, "FM" for all six.
    """
    parts = []
    for letter in of:
        for axis in range(3):
            row = int(np.argmax(np.abs(wiring[:, axis])))
            sign = "" if wiring[row, axis] > 0.0 else "-"
            if row != axis or sign:
                parts.append(f"{letter}{AXES[axis]} = {sign}{letter}{AXES[row]}")
    return f"in the driver or the adapter: remap {', '.join(parts)}"

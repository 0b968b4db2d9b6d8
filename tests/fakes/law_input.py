"""Samples of a control law in a mode of the specification."""

from typing import Any

import pinocchio as pin

from forcemesh.messages import Mode, Vec3
from services.regulator.axis_task import mode_task
from services.regulator.gains import PiGains
from services.regulator.law import LawInput, LawMotion


def mode_input(
    force_N: Vec3,
    torque_Nm: Vec3,
    setpoint_N: float,
    mode: Mode,
    dt_s: float,
    gains: PiGains,
    motion: LawMotion,
    T_measured: pin.SE3,
    frame: str = "base",
    axes: tuple[bool, ...] = (True,) * 6,
    **others: Any,
) -> LawInput:
    """Return a sample whose task is that of a mode, a set point and free axes."""
    press_axis = T_measured.rotation[:, 2].tolist()
    in_base = frame == "base"
    task = mode_task(mode, setpoint_N, axes=axes, in_base=in_base, press_axis=press_axis)
    return LawInput(force_N, torque_Nm, task, dt_s, gains, motion, T_measured, **others)

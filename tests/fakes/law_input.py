"""Samples of a control law in a mode of the specification."""

from typing import Any

import pinocchio as pin

from common.motion.rate_limiter import REST
from control.axis_task import mode_task
from control.compliance import ComplianceState
from control.gain_rule import tune
from control.law import LawInput, LawMotion, start_at
from control.shape import MotionLimits, shape
from forcemesh.messages import ZERO3, Gains, Mode, Vec3
from tests.fakes.arbiter_world import CELL, T_START

DT_S = 0.004
GAINS = tune(CELL).gains
START = T_START * CELL.tool.T_flange_tcp.pose  # of the TCP: the tool points down
LIMITS = MotionLimits.of(CELL, predicts=False)


def mode_input(
    force_N: Vec3 = ZERO3,
    torque_Nm: Vec3 = ZERO3,
    setpoint_N: float = 0.0,
    mode: Mode = "position",
    dt_s: float = DT_S,
    gains: Gains = GAINS,
    motion: LawMotion | None = None,
    T_measured: pin.SE3 | None = None,
    **others: Any,
) -> LawInput:
    """Return a sample whose task is that of a mode and a set point."""
    motion = motion or start_at(START)
    T_measured = T_measured or motion.T_base_tcp
    press_axis = T_measured.rotation[:, 2].tolist()
    task = mode_task(mode, setpoint_N, in_base=True, press_axis=press_axis)
    return LawInput(force_N, torque_Nm, task, dt_s, gains, motion, T_measured, **others)


def shaped(motion: LawMotion, sample: LawInput, limits: MotionLimits = LIMITS) -> LawMotion:
    """Return the motion that a law wants, as it is commanded."""
    T = sample.motion.T_base_tcp
    shape(motion, REST, sample, ComplianceState.at(sample.task, T, T), limits=limits)
    return motion

"""Gains of force feedback: ramped, changed by request, and sent to a controller. Pure."""

import numpy as np
from msgspec.structs import astuple

from common.config.cell import CellConfig
from common.motion.convert import vec3
from common.motion.frames import Rows, product, scaled
from control.axis_task import AxisTask
from control.gain_rule import tune
from forcemesh.messages import Gains, Vec3
from forcemesh.requests import GainsRequest

GAIN_RAMP_S = 0.1  # time constant
HALF = 0.5  # component of an axis along the base axis that it is
SAME_GAIN = 0.15  # relative change of the controller's gains below which no command is sent


def gains_of(force_p: Vec3, force_i: Vec3, torque_p: Vec3, torque_i: Vec3) -> Gains:
    """Return gains in the order of the message."""
    return Gains(
        force_p_m_per_N=force_p, force_i_m_per_Ns=force_i,
        torque_p_rad_per_Nm=torque_p, torque_i_rad_per_Nms=torque_i,
    )  # fmt: skip


def scaled_gains(gains: Gains, share: float) -> Gains:
    """Return all gains times a share: the same ones at share 1."""
    if share == 1.0:
        return gains
    return gains_of(*(scaled(row, share) for row in astuple(gains)))


def ramped_gains(gains: Gains, goal: Gains, dt_s: float) -> Gains:
    """Return gains one period further towards a goal (first-order low-pass)."""
    if gains is goal:
        return goal
    share = min(1.0, dt_s / GAIN_RAMP_S)
    now, then = np.array(astuple(gains)), np.array(astuple(goal))
    is_near = np.abs(then - now) <= 1e-3 * np.abs(then)
    if is_near.all():
        return goal
    return gains_of(*map(vec3, np.where(is_near, then, now + share * (then - now))))


def merged_gains(gains: Gains, change: GainsRequest, cell: CellConfig) -> Gains:
    """Return the gains after a request: its preset first, then its single gains."""
    if change.preset is not None:
        gains = tune(cell, change.preset).gains
    return gains.replaced(**{k: v for k, v in change.changes.items() if k != "preset"})


def held_gains(gains: Gains, task: AxisTask, R_base_task: Rows) -> Gains:
    """Return the controller's gains with zeros for the held axes, which are base axes then.

    A task that the controller can run has either no held axis of a kind or base axes
    (`refusals.refused_task`).
    """
    along, about = (
        [
            any(flag and abs(part) > HALF for flag, part in zip(flags, row, strict=True))
            or not moves
            for row in R_base_task
        ]
        for flags, moves in (
            (task.force_along, any(task.force_along)),
            (task.torque_about, any(task.torque_about)),
        )
    )
    if all(along) and all(about):
        return gains
    return gains.replaced(
        force_p_m_per_N=product(gains.force_p_m_per_N, along),
        force_i_m_per_Ns=product(gains.force_i_m_per_Ns, along),
        torque_p_rad_per_Nm=product(gains.torque_p_rad_per_Nm, about),
        torque_i_rad_per_Nms=product(gains.torque_i_rad_per_Nms, about),
    )


def gains_to_send(sent: Gains | None, requested: Gains, Ki: Vec3) -> Gains:
    """Return the controller's gains with an integral gain `Ki`; small changes are not sent."""
    if sent is not None:
        pairs = zip(Ki, sent.force_i_m_per_Ns, strict=True)
        if all(abs(then - now) <= SAME_GAIN * now for then, now in pairs):
            return sent
    return requested.replaced(force_i_m_per_Ns=Ki)

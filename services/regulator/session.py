"""One session of force feedback: what is wanted, what is remembered, what ends it. Pure."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from common.endpoints import Reading
from common.messages import ArbiterStatus, Gains
from common.requests import ForceStartRequest
from services.regulator.adaptive import Adaptive
from services.regulator.guards import Seen, Watch
from services.regulator.law import LawInput, LawState

MOVERS = ("operator", "program")  # while one of them moves the arm, nothing is proposed


class Failure(NamedTuple):
    """Why the regulator gave up, as a code of common/faults.py and in words."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Session:
    """Force feedback from its start to its stop."""

    wanted: ForceStartRequest
    setpoint_N: float  # ramped
    law: LawState
    last_sample_ns: int
    lease: int  # under which it was started
    watch: Watch
    gains: Gains  # ramped
    memory: Adaptive | None = None  # of the adaptive law, if that one runs
    sent: Gains | None = None  # to the controller, from the stiffness that is met
    failure: Failure | None = None  # latched: an input failed, or a guard gave up


def mover(arbiter: ArbiterStatus) -> str:
    """Return who moves the arm, or is about to; empty when nobody but the regulator may."""
    both = (arbiter.commander, arbiter.next_commander)
    return next((who for who in both if who in MOVERS), "")


def seen_by(
    law: LawState, sample: LawInput, T_base_tcp: pin.SE3, memory: Adaptive | None = None
) -> Seen:
    """Return what the guards watch of one sample; no contact is sought in mode orientation."""
    error_N = np.zeros(3) if law.error_force_N is None else law.error_force_N
    error_Nm = np.zeros(3) if law.error_torque_Nm is None else law.error_torque_Nm
    moves, turns = sample.mode != "orientation", sample.mode != "position"
    return Seen(
        force_N=sample.force_N,
        torque_Nm=sample.torque_Nm,
        T_base_tcp=T_base_tcp,
        contact=law.contact if moves else "free",
        error=np.concatenate((error_N * moves, error_Nm * turns)),
        turns=turns,
        dt_s=sample.dt_s,
        follows=memory is not None and memory.follow.near,
    )


def failure_of(reading: Reading[Any]) -> Failure | None:
    """Return why an input cannot be used, if it cannot."""
    return Failure(reading.code, reading.fault) if reading.fault else None

"""What must be so before a person's `arm` is obeyed: one literal list. Pure.

A check that is for force alone is left out when the arm is armed for jog, so that one can always
move away: also in contact, also without calibration.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.cell import Cell
from common.config import cell_hash
from common.convert import vec3
from common.faults import tripped
from common.limits import Limits
from common.messages import Purpose, Trip, Vec3
from common.version import forcemesh_version
from services.arbiter.inputs import Inputs, limit_trip, missing, robot_complaints, strangers

PREFLIGHT_S = 1.0  # inputs must have been good for so long


@dataclass(frozen=True, slots=True)
class Terms:
    """What of this process and its cell file the preflight judges by."""

    config_hash: str
    version: str
    limits: Limits
    p_flange_tcp_m: Vec3
    approach_m_s: float
    approach_limit_m_s: float

    @classmethod
    def of(cls, cell: Cell) -> "Terms":
        """Take the terms out of a cell file."""
        return cls(
            config_hash=cell_hash(cell),
            version=forcemesh_version(),
            limits=Limits.of(cell),
            p_flange_tcp_m=vec3(np.asarray(cell.tool.T_flange_tcp.pose.translation)),
            approach_m_s=cell.force.approach_m_s,
            approach_limit_m_s=cell.approach_limit_m_s,
        )


class Look(NamedTuple):
    """What is judged."""

    inputs: Inputs
    terms: Terms
    good_s: float  # how long the inputs have been heard and good


class Check(NamedTuple):
    """One row of the preflight."""

    what: str
    complaints: Callable[[Look], list[Trip]]
    for_force_only: bool = False


def _steady(look: Look) -> list[Trip]:
    if look.good_s >= PREFLIGHT_S:
        return []
    text = f"inputs are good for {look.good_s:.1f} s, {PREFLIGHT_S:g} s are needed"
    return [tripped("not_ready", text, value=look.good_s, limit=PREFLIGHT_S)]


def _controller(look: Look) -> list[Trip]:
    return robot_complaints(look.inputs)


def _strangers(look: Look) -> list[Trip]:
    return strangers(look.inputs, look.terms.config_hash, look.terms.version)


def _limits(look: Look) -> list[Trip]:
    return _some(limit_trip(look.inputs, look.terms.limits, look.terms.p_flange_tcp_m))


def _rest(look: Look) -> list[Trip]:
    return _some(look.inputs.watched.unrest)


def _residual(look: Look) -> list[Trip]:
    return _some(look.inputs.watched.residual)


def _calibration(look: Look) -> list[Trip]:
    wrench = look.inputs.wrench.fresh
    if wrench is None or wrench.calibrated:
        return []
    return [tripped("payload", wrench.calibration_fault or "the wrench is not calibrated")]


def _approach(look: Look) -> list[Trip]:
    value, limit = look.terms.approach_m_s, look.terms.approach_limit_m_s
    if value <= limit:
        return []
    text = (
        f"force.approach_m_s is {value * 1e3:.2f} mm/s: force.approach_budget_N over stiffness "
        f"times all delay in the loop allows {limit * 1e3:.2f} mm/s"
    )
    return [tripped("approach_speed", text, value=value, limit=limit)]


def _some(trip: Trip | None) -> list[Trip]:
    return [] if trip is None else [trip]


# fmt: off
CHECKS: tuple[Check, ...] = (
    Check("every input is heard, good, in order and in time", lambda look: missing(look.inputs)),
    Check("and has been so for a second",                     _steady),
    Check("the controller is fit to move",                    _controller),
    Check("every process has this cell file and version",     _strangers),
    Check("force below its ceiling, tool in the workspace",   _limits),
    Check("the arm rests where it was commanded",             _rest),
    Check("the calibration holds for this tool and sensor",   _calibration, for_force_only=True),
    Check("hardly any force was left in free space",          _residual,    for_force_only=True),
    Check("the approach is slow enough for the stiffness",    _approach,    for_force_only=True),
)
# fmt: on


def complaints(inputs: Inputs, terms: Terms, good_s: float, purpose: Purpose) -> list[Trip]:
    """Return why the arm must not be armed; when an input is not good, that alone.

    Args:
        inputs: What is known now.
        terms: What it is judged by.
        good_s: How long the inputs have been good [s].
        purpose: `jog` leaves out what matters for force feedback alone.
    """
    look = Look(inputs, terms, good_s)
    found = CHECKS[0].complaints(look)
    if found:
        return found
    rows = [row for row in CHECKS[1:] if purpose == "all" or not row.for_force_only]
    return [trip for row in rows for trip in row.complaints(look)]


def lasting(trips: list[Trip]) -> list[Trip]:
    """Return what will still be in the way when an arm that moves now has come to rest."""
    return [trip for trip in trips if trip.code != "moving"]

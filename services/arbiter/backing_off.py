"""Backing off under the arbiter: the goal that frees the arm, and its end conditions. Pure.

The path is that of common/motion/back_off.py, which the robot process computes again by itself;
the limits on the way are those of `ArmCheck`.
"""

from dataclasses import dataclass
from math import hypot

import pinocchio as pin

from common.motion import back_off
from common.motion.back_off import BackOffPlan
from common.motion.convert import pose_of, record_of
from common.motion.limits import Limits
from forcemesh.faults import tripped
from forcemesh.messages import Goal, RobotState, Speed, Trip, WrenchAtTcp
from services.arbiter.inputs import Inputs, fault_trips
from services.arbiter.preflight import PreflightSettings


@dataclass(frozen=True, slots=True)
class BackingOff:
    """One back-off, from arming to its end."""

    plan: BackOffPlan
    T_start: pin.SE3  # flange in base
    limits: Limits  # of the cell: the arm is free within them
    T_flange_tcp: pin.SE3
    wrench: WrenchAtTcp | None  # from which it was planned
    blind: bool  # without sensor or wrench: their inputs are not required
    unknown: tuple[Trip, ...]  # why it is blind, else empty: still a fault when it ends

    @property
    def speed(self) -> Speed:
        """Speed of backing off, at most the cell's limit."""
        return Speed(mechanical_m_s=min(back_off.SPEED_M_S, self.limits.speed_m_s))

    @property
    def goal(self) -> Goal:
        """The move that frees the arm."""
        return Goal(id=0, kind="pose", pose=record_of(self.plan.goal(self.T_start)))

    def freed(self, T: pin.SE3, wrench: WrenchAtTcp | None) -> Trip | None:
        """Return the trip of an arm that is free."""
        if back_off.is_over(self.plan.kind, self.limits, T * self.T_flange_tcp, wrench):
            return tripped("back_off", f"free after {self._progress(T, wrench)}")
        return None

    def at_its_end(self, T: pin.SE3, wrench: WrenchAtTcp | None) -> Trip:
        """Return the trip of a back-off that used its full travel."""
        return tripped("still_loaded", f"full travel used: {self._progress(T, wrench)}")

    def _progress(self, T: pin.SE3, wrench: WrenchAtTcp | None) -> str:
        """Return the tool's travel and the present force as a text."""
        travel_mm = 1e3 * hypot(*(T.translation - self.T_start.translation))
        force = "force unknown" if wrench is None else f"{hypot(*wrench.force_N):.1f} N now"
        return f"{travel_mm:.1f} mm, {force}"


def is_blind(inputs: Inputs) -> bool:
    """Return whether no valid force is available."""
    return inputs.wrench.fresh is None or inputs.sensor.fresh is None


def begin(
    inputs: Inputs, robot: RobotState, settings: PreflightSettings, *, confirmed: bool
) -> BackingOff | Trip:
    """Return the back-off from here, or why there is none.

    Args:
        inputs: Present snapshot.
        robot: State of the robot.
        settings: The cell's limits and tool.
        confirmed: Whether a person has agreed to back off without a measured force.
    """
    T, blind = pose_of(robot), is_blind(inputs)
    wrench = None if blind else inputs.wrench.fresh
    limits, T_flange_tcp = settings.limits, settings.T_flange_tcp
    plan = back_off.plan(limits, T, T_flange_tcp, wrench, confirmed=confirmed)
    if isinstance(plan, Trip):
        return plan
    unknown = tuple(fault_trips(inputs)) if blind else ()
    return BackingOff(plan, T, limits, T_flange_tcp, wrench, blind, unknown)

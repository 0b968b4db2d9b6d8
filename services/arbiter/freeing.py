"""Backing off under the arbiter: the goal that frees the arm, and its end conditions. Pure.

The rules are those of common/motion/back_off.py, which the robot process checks again by itself.
"""

from dataclasses import dataclass, replace
from math import hypot

import pinocchio as pin

from common.motion import back_off
from common.motion.back_off import BackOffPlan, BackOffState
from common.motion.convert import pose_of, record_of
from common.motion.last_check import MEASURED_SLACK_M
from common.motion.limits import ArmBounds, Limits
from forcemesh.faults import tripped
from forcemesh.messages import Goal, RobotState, Speed, Trip, WrenchAtTcp
from services.arbiter.inputs import Inputs, fault_trips


@dataclass(slots=True)
class Freeing:
    """One back-off, from arming to its end; its run advances in place."""

    plan: BackOffPlan
    run: BackOffState
    limits: Limits  # of the cell: the arm is free within them
    bounds: ArmBounds  # limits while backing off
    blind: bool  # without sensor or wrench: their inputs are not required
    unknown: tuple[Trip, ...]  # why it is blind, else empty: still a fault when it ends

    @property
    def speed(self) -> Speed:
        """Speed of backing off, at most the cell's limit."""
        return Speed(mechanical_m_s=min(back_off.SPEED_M_S, self.limits.speed_m_s))

    @property
    def goal(self) -> Goal:
        """The move that frees the arm."""
        return Goal(id=0, kind="pose", pose=record_of(self.plan.goal(self.run.T_start)))

    def watch(self, T: pin.SE3, wrench: WrenchAtTcp | None, now_ns: int) -> Trip | None:
        """Advance by a period; return why it must end: freed, or unable to get free."""
        self.run, trip = self.run.update_load(wrench)
        trip = trip or self.run.moved(T, now_ns)
        T_base_tcp = T * self.bounds.T_flange_tcp
        if trip is None and back_off.is_over(self.plan.kind, self.limits, T_base_tcp, wrench):
            trip = tripped("back_off", f"free after {self._progress(T, wrench)}")
        return trip

    def at_its_end(self, T: pin.SE3, wrench: WrenchAtTcp | None) -> Trip:
        """Return the trip of a back-off that used its full travel."""
        return tripped("still_loaded", f"full travel used: {self._progress(T, wrench)}")

    def _progress(self, T: pin.SE3, wrench: WrenchAtTcp | None) -> str:
        """Return the tool's travel and the present force as a text."""
        travel_mm = 1e3 * hypot(*(T.translation - self.run.T_start.translation))
        force = "force unknown" if wrench is None else f"{hypot(*wrench.force_N):.1f} N now"
        return f"{travel_mm:.1f} mm, {force}"


def is_blind(inputs: Inputs) -> bool:
    """Return whether no valid force is available."""
    return inputs.wrench.fresh is None or inputs.sensor.fresh is None


def begin(
    inputs: Inputs, robot: RobotState, bounds: ArmBounds, *, confirmed: bool
) -> Freeing | Trip:
    """Return the back-off from here, or why there is none.

    Args:
        inputs: Present snapshot.
        robot: State of the robot.
        bounds: The cell's limits and tool.
        confirmed: Whether a person has agreed to back off without a measured force.
    """
    T, blind = pose_of(robot), is_blind(inputs)
    wrench = None if blind else inputs.wrench.fresh
    plan = back_off.plan(bounds.limits, T, bounds.T_flange_tcp, wrench, confirmed=confirmed)
    if isinstance(plan, Trip):
        return plan
    relaxed = back_off.relaxed_limits(bounds.limits, T * bounds.T_flange_tcp, MEASURED_SLACK_M)
    return Freeing(
        plan=plan,
        run=BackOffState(T, inputs.now_ns),
        limits=bounds.limits,
        bounds=replace(bounds, limits=relaxed, T_armed=T),
        blind=blind,
        unknown=tuple(fault_trips(inputs)) if blind else (),
    )

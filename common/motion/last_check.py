"""Last check of the arbiter's limits before the robot, with its own process, config and state.

The gateway and the simulated arm both use it. Pure: measurements and times are arguments.
Every rule returns a `Trip`; an accepted command is within all limits.
"""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, inf

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion import back_off
from common.motion.back_off import BackOffState, LoadRatchet
from common.motion.convert import pose_of
from common.motion.frames import Array, interpolated, is_finite_pose
from common.motion.limits import (
    MEASURED_SLACK_RAD,
    ArmBounds,
    JointTrack,
    Limits,
    check_apart,
    check_speed,
    check_wrench,
    joint_goal,
)
from common.motion.setpoint_monitor import SetpointMonitor
from forcemesh.faults import tripped
from forcemesh.messages import Feedback, Goal, Joints, Purpose, Speed, Trip, WrenchAtTcp

# Tolerance of measured values beyond a limit on commands: rounding of reports, settling.
MEASURED_SLACK_M = 2e-3
JOINT_SPEED_MARGIN = 1.1  # over what the joints can do, which is above the arbiter's limit
LONGEST_CENTRE_M = 0.3  # from the TCP to a contact point: beyond any tool
PATH_SAMPLES = 25
ROUNDING_M = 2e-4  # between two readings of an arm at rest

FlangeAt = Callable[[Array], pin.SE3]


class LastCheck:
    """Limit check of commands and of the measured arm, with the limits of this cell."""

    def __init__(self, cell: CellConfig, flange_at: FlangeAt | None = None) -> None:
        """Store the cell's limits; nothing is allowed before `start`.

        Args:
            cell: The cell file.
            flange_at: Forward kinematics from joint angles [rad], if the arm's geometry is known:
                joint moves are then also checked by the path of the tool.
        """
        self._limits = Limits.of(cell)
        self._T_flange_tcp: pin.SE3 = cell.tool.T_flange_tcp.pose
        self._fastest_rad_s = np.radians(cell.robot.joint_speed_max_deg_s)
        self._setpoint_max_N = cell.force.setpoint_max_N
        self._flange_at = flange_at
        # Of the measured arm; no tether before a lease.
        untethered = replace(self._limits, tether_m=inf, tether_rad=inf)
        self._wide = self._widened(untethered, pin.SE3.Identity())
        self._bounds = self._wide  # of commands under the present lease
        self._back_off: BackOffState | None = None  # under a lease for that
        # The refusal of every command: before a lease; of all others under a lease for backing off.
        self._refusal: Trip | None = tripped("no_lease", "no lease has begun")
        self._load: LoadRatchet | None = None  # of the move under way
        self._wrench: WrenchAtTcp | None = None
        self._monitor = SetpointMonitor(self._limits)
        self._joints = JointTrack()

    def start(self, T_base_flange: pin.SE3, now_ns: int = 0, purpose: Purpose = "all") -> None:
        """Begin a lease: the tether starts at the present pose.

        A lease for `back_off` has its own limits (common/motion/back_off.py) until the next lease.
        """
        T_armed, limits = T_base_flange.copy(), self._limits
        self._back_off = self._load = self._refusal = None
        if purpose == "back_off":
            text = "the arm was armed to back off: it accepts only that goal"
            self._refusal = tripped("state", text)
            limits = back_off.relaxed_limits(limits, T_armed * self._T_flange_tcp, ROUNDING_M)
            self._back_off = BackOffState(T_armed, now_ns)
        self._bounds = ArmBounds(limits, self._T_flange_tcp, T_armed)
        self._wide = self._widened(limits, T_armed)

    # --- commands ---------------------------------------------------------------------------------

    def seed(self, T_base_flange: pin.SE3, now_ns: int) -> Trip | None:
        """Begin a stream of set points at the measured pose."""
        return self.place(T_base_flange) or self._monitor.begin(T_base_flange, now_ns)

    def setpoint(self, T_target: pin.SE3, T_measured: pin.SE3, now_ns: int) -> Trip | None:
        """Check a set point; an accepted one consumes its share of the stream budget."""
        return (
            self.place(T_target)
            or check_apart("step", self._limits, T_measured, T_target)
            or self._monitor.check(T_target, now_ns)
        )

    def goal(
        self, goal: Goal, speed: Speed, T_measured: pin.SE3, joint_rad: Joints | Array
    ) -> Trip | None:
        """Check a move: its end, and its path as far as known.

        Args:
            goal: The move.
            speed: How fast.
            T_measured: Measured flange pose in base.
            joint_rad: Measured joint angles [rad].
        """
        if self._back_off is not None:
            trip = self._back_off_trip(goal, speed, T_measured)
        else:
            trip = (
                self._refusal
                or check_speed(self._limits, speed)
                or self._bounds.goal(goal, joint_rad)
                or self._path_trip(goal, T_measured, np.array(joint_rad))
            )
        if trip is None:
            self._monitor.moved_otherwise()
        return trip

    def feedback(self, feedback: Feedback) -> Trip | None:
        """Check a request for force feedback in the controller, which limits its own speeds."""
        if self._refusal is not None:
            return self._refusal
        setpoint_N = hypot(*feedback.setpoint_force_N)
        if setpoint_N > self._setpoint_max_N:
            text = f"a set point of {setpoint_N:.1f} N"
            return tripped("setpoint", text, value=setpoint_N, limit=self._setpoint_max_N, unit="N")
        setpoint_Nm = hypot(*feedback.setpoint_torque_Nm)
        if setpoint_Nm > self._limits.torque_Nm:
            text, most_Nm = f"a torque set point of {setpoint_Nm:.2f} N m", self._limits.torque_Nm
            return tripped("setpoint", text, value=setpoint_Nm, limit=most_Nm, unit="N m")
        lever_m = hypot(*feedback.lever_m)
        if lever_m > LONGEST_CENTRE_M:
            text = f"centre of rotation {lever_m * 1e3:.0f} mm away from the TCP"
            return tripped("malformed", text, value=lever_m, limit=LONGEST_CENTRE_M, unit="m")
        self._monitor.moved_otherwise()
        return None

    def wrench(self, wrench: WrenchAtTcp | None, *, in_move: bool = False) -> Trip | None:
        """Check the wrench, if known; a move must not rise much above its lowest load."""
        self._wrench = wrench
        if self._back_off is not None:
            self._back_off, trip = self._back_off.update_load(wrench)
            return trip
        if not in_move:
            self._load = None
        if wrench is None:
            return None
        trip = check_wrench(self._limits, wrench.force_N, wrench.torque_Nm)
        if trip is None and in_move and wrench.calibrated:
            self._load, trip = back_off.in_move(self._limits, self._load, wrench)
        return trip

    def place(self, T_target: pin.SE3) -> Trip | None:
        """Check the flange pose of a set point: TCP in the workspace, flange within the tether."""
        return self._refusal or self._bounds.place(T_target)

    def arm(self, T_measured: pin.SE3, joint_rad: Joints | Array, now_ns: int) -> Trip | None:
        """Check pose and joint speeds of the arm; call it for every report."""
        self._joints.add(now_ns, joint_rad)
        trip = self._wide.measured(
            T_measured, joint_rad, self._joints, speed_margin=JOINT_SPEED_MARGIN
        )
        if trip is None and self._back_off is not None:
            trip = self._back_off.moved(T_measured, now_ns)
        return trip

    # --- inside -----------------------------------------------------------------------------------

    def _back_off_trip(self, goal: Goal, speed: Speed, T_measured: pin.SE3) -> Trip | None:
        """Compare a goal with the path that this process computes itself."""
        if goal.kind != "pose" or goal.pose is None:
            return self._refusal
        limits, wrench = self._limits, self._wrench
        expected = back_off.plan(limits, T_measured, self._T_flange_tcp, wrench, confirmed=True)
        T_goal = pose_of(goal.pose)
        trip = back_off.goal_trip(expected, T_measured, T_goal, speed)
        return trip or self._bounds.place(T_goal)

    def _path_trip(self, goal: Goal, T_from: pin.SE3, q_from: Array) -> Trip | None:
        """Check the path to a permitted end, without its first pose, which `arm` checks."""
        shares = np.linspace(0.0, 1.0, PATH_SAMPLES)[1:]
        if goal.pose is not None and goal.kind == "pose":
            if not is_finite_pose(T_from):
                return None  # no path can be sampled from nowhere: its end counts
            T_to = pose_of(goal.pose)
            path = [interpolated(T_from, T_to, share) for share in shares]
        elif self._flange_at is not None:
            travel = joint_goal(goal, q_from) - q_from
            path = [self._flange_at(q_from + share * travel) for share in shares]
        else:
            return None
        for T in path[:-1]:
            if (trip := self._wide.place(T)) is not None:
                return trip.replaced(text=f"on the path: {trip.text}")
        return self._bounds.place(path[-1])

    def _widened(self, limits: Limits, T_armed: pin.SE3) -> ArmBounds:
        """Return the bounds of measured values: slightly wider than those of commands."""
        wide = replace(
            limits,
            workspace_min_m=limits.workspace_min_m - MEASURED_SLACK_M,
            workspace_max_m=limits.workspace_max_m + MEASURED_SLACK_M,
            planes=tuple(
                replace(plane, point_m=plane.point_m - MEASURED_SLACK_M * plane.normal)
                for plane in limits.planes
            ),
            joint_speed_rad_s=self._fastest_rad_s,
            tether_m=limits.tether_m + MEASURED_SLACK_M,
            tether_rad=limits.tether_rad + MEASURED_SLACK_RAD,
        )
        return ArmBounds(wide, self._T_flange_tcp, T_armed)

"""Last check of the arbiter's limits before the robot, with its own process, config and state.

The gateway and the simulated arm both use it. Pure: measurements and times are arguments.
Every rule returns a `Trip`; an accepted command is within all limits.
"""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from math import radians

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion import back_off
from common.motion.back_off import BackOffState, LoadRatchet
from common.motion.convert import pose_of
from common.motion.frames import Array, is_finite_pose, rotation_between, rotation_from_vector
from common.motion.limits import (
    Limits,
    check_joint_count,
    check_joints,
    check_step,
    check_tether,
    check_workspace,
    check_wrench,
)
from common.motion.setpoint_monitor import S_PER_NS, SetpointMonitor
from forcemesh.faults import tripped
from forcemesh.messages import Feedback, Goal, Joints, Purpose, Speed, Trip, WrenchAtTcp

# Tolerance of measured values beyond a limit on commands: rounding of reports, settling.
MEASURED_SLACK_M = 2e-3
MEASURED_SLACK_RAD = radians(0.5)
JOINT_SPEED_MARGIN = 1.1
JOINT_SPEED_OVER_S = 0.1
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
        self._cell_limits = self._limits = Limits.of(cell)
        self._wide = _widened(self._limits)
        self._back_off: BackOffState | None = None  # under a lease for that
        self._load: LoadRatchet | None = None  # of the move under way
        self._wrench: WrenchAtTcp | None = None
        self._T_flange_tcp: pin.SE3 = cell.tool.T_flange_tcp.pose
        self._setpoint_max_N = cell.force.setpoint_max_N
        self._joint_speed_max = np.radians(cell.robot.joint_speed_max_deg_s)
        self._flange_at = flange_at
        self._T_armed: pin.SE3 | None = None
        self._monitor = SetpointMonitor(cell.limits)
        self._joints: deque[tuple[int, Array]] = deque()

    def start(self, T_base_flange: pin.SE3, now_ns: int = 0, purpose: Purpose = "all") -> None:
        """Begin a lease: the tether starts at the present pose.

        A lease for `back_off` has its own limits (common/motion/back_off.py) until the next lease.
        """
        self._T_armed = T_base_flange.copy()
        self._limits, self._back_off, self._load = self._cell_limits, None, None
        if purpose == "back_off":
            T_base_tcp = T_base_flange * self._T_flange_tcp
            self._limits = back_off.relaxed_limits(self._cell_limits, T_base_tcp, ROUNDING_M)
            self._back_off = BackOffState(self._T_armed, now_ns)
        self._wide = _widened(self._limits)

    # --- commands ---------------------------------------------------------------------------------

    def seed(self, T_base_flange: pin.SE3, now_ns: int) -> Trip | None:
        """Begin a stream of set points at the measured pose."""
        return (
            self._only_backing_off()
            or self.place(T_base_flange)
            or self._monitor.begin(T_base_flange, now_ns)
        )

    def setpoint(self, T_target: pin.SE3, T_measured: pin.SE3, now_ns: int) -> Trip | None:
        """Check a set point; an accepted one consumes its share of the stream budget."""
        return (
            self._only_backing_off()
            or self.place(T_target)
            or check_step(self._limits, T_measured, T_target)
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
            return self._back_off_trip(goal, speed, T_measured)
        real_m_s = speed.mechanical_m_s * speed.modular_fraction
        if real_m_s > self._limits.speed_m_s:
            text = "mechanical times modular speed is above limits.speed_m_s"
            return tripped("speed", text, value=real_m_s, limit=self._limits.speed_m_s, unit="m/s")
        if goal.kind == "pose" and goal.pose is not None:
            trip = self._pose_trip(T_measured, pose_of(goal.pose))
        elif goal.kind != "pose" and goal.joint_rad is not None:
            if (trip := check_joint_count(self._limits, goal.joint_rad)) is not None:
                return trip
            q_from = np.array(joint_rad)
            start = q_from if goal.kind == "by" else np.zeros(len(q_from))
            trip = self._joint_trip(q_from, start + np.array(goal.joint_rad))
        else:
            return tripped("malformed", f"a goal of kind {goal.kind} without its numbers")
        if trip is None:
            self._monitor.moved_otherwise()
        return trip

    def feedback(self, feedback: Feedback) -> Trip | None:
        """Check a request for force feedback in the controller, which limits its own speeds."""
        if (trip := self._only_backing_off()) is not None:
            return trip
        setpoint_N = float(np.linalg.norm(feedback.setpoint_force_N))
        if setpoint_N > self._setpoint_max_N:
            text = f"a set point of {setpoint_N:.1f} N"
            return tripped("setpoint", text, value=setpoint_N, limit=self._setpoint_max_N, unit="N")
        lever_m = float(np.linalg.norm(feedback.lever_m))
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
        """Check a flange pose: TCP inside the workspace, flange within the tether."""
        if self._T_armed is None:
            return tripped("no_lease", "no lease has begun")
        trip = check_workspace(self._limits, T_target * self._T_flange_tcp)
        return trip or self._tether_trip(self._limits, T_target)

    # --- the arm ----------------------------------------------------------------------------------

    def arm(self, T_measured: pin.SE3, joint_rad: Joints | Array, now_ns: int) -> Trip | None:
        """Check pose and joint speeds of the arm; call it for every report."""
        q = np.array(joint_rad)
        return (
            check_joints(self._wide, q)
            or self._joint_speed_trip(q, now_ns)
            or check_workspace(self._wide, T_measured * self._T_flange_tcp)
            or self._tether_trip(self._wide, T_measured)
            or (None if self._back_off is None else self._back_off.moved(T_measured, now_ns))
        )

    def _joint_speed_trip(self, q: Array, now_ns: int) -> Trip | None:
        """Check the mean over a tenth of a second, because reports are rounded and have jitter."""
        joints = self._joints
        joints.append((now_ns, q))
        while len(joints) > 2 and (now_ns - joints[1][0]) * S_PER_NS >= JOINT_SPEED_OVER_S:
            joints.popleft()
        time_s = (now_ns - joints[0][0]) * S_PER_NS
        if time_s < JOINT_SPEED_OVER_S:
            return None
        share = np.abs(q - joints[0][1]) / time_s / self._joint_speed_max
        worst = int(np.argmax(share))
        if share[worst] <= JOINT_SPEED_MARGIN:
            return None
        limit = float(self._joint_speed_max[worst])
        value = float(share[worst]) * limit
        text = f"joint {worst + 1} turns at {np.degrees(value):.0f} degrees/s"
        return tripped("joint_speed", text, value=value, limit=limit, unit="rad/s")

    # --- inside -----------------------------------------------------------------------------------

    def _only_backing_off(self) -> Trip | None:
        if self._back_off is None:
            return None
        return tripped("state", "the arm was armed to back off: it accepts only that goal")

    def _back_off_trip(self, goal: Goal, speed: Speed, T_measured: pin.SE3) -> Trip | None:
        """Compare a goal with the path that this process computes itself."""
        if goal.kind != "pose" or goal.pose is None:
            return self._only_backing_off()
        limits, wrench = self._cell_limits, self._wrench
        expected = back_off.plan(limits, T_measured, self._T_flange_tcp, wrench, confirmed=True)
        T_goal = pose_of(goal.pose)
        trip = back_off.goal_trip(expected, T_measured, T_goal, speed) or self.place(T_goal)
        if trip is None:
            self._monitor.moved_otherwise()
        return trip

    def _tether_trip(self, limits: Limits, T: pin.SE3) -> Trip | None:
        return None if self._T_armed is None else check_tether(limits, self._T_armed, T)

    def _pose_trip(self, T_from: pin.SE3, T_to: pin.SE3) -> Trip | None:
        """Check a straight move: its end first, then the path of the rotating tool."""
        trip = self.place(T_to)
        return trip or self._path_trip(_between(T_from, T_to))

    def _joint_trip(self, q_from: Array, q_to: Array) -> Trip | None:
        if self._T_armed is None:
            return tripped("no_lease", "no lease has begun")
        trip = check_joints(self._limits, q_to)
        if trip is not None or self._flange_at is None:
            return trip
        shares = np.linspace(0.0, 1.0, PATH_SAMPLES)
        flange_at = self._flange_at
        return self._path_trip(flange_at(q_from + share * (q_to - q_from)) for share in shares)

    def _path_trip(self, path: Iterable[pin.SE3]) -> Trip | None:
        """Check a path without its first pose, which `arm` checks."""
        poses = list(path)
        for T in poses[1:-1]:
            trip = check_workspace(self._wide, T * self._T_flange_tcp)
            trip = trip or self._tether_trip(self._wide, T)
            if trip is not None:
                return trip.replaced(text=f"on the path: {trip.text}")
        return self.place(poses[-1])


def _between(T_from: pin.SE3, T_to: pin.SE3) -> Iterable[pin.SE3]:
    """Yield poses on a straight line with uniform rotation about one axis."""
    if not (is_finite_pose(T_from) and is_finite_pose(T_to)):
        yield from (T_from, T_to)
        return
    translation = T_to.translation - T_from.translation
    rotation = rotation_between(T_from.rotation, T_to.rotation)
    for share in np.linspace(0.0, 1.0, PATH_SAMPLES):
        R = rotation_from_vector(share * rotation) @ T_from.rotation
        yield pin.SE3(R, T_from.translation + share * translation)


def _widened(limits: Limits) -> Limits:
    """Return the limits of measured values: slightly wider than those of commands."""
    return replace(
        limits,
        workspace_min_m=limits.workspace_min_m - MEASURED_SLACK_M,
        workspace_max_m=limits.workspace_max_m + MEASURED_SLACK_M,
        planes=tuple(
            replace(plane, point_m=plane.point_m - MEASURED_SLACK_M * plane.normal)
            for plane in limits.planes
        ),
        joint_min_rad=limits.joint_min_rad - MEASURED_SLACK_RAD,
        joint_max_rad=limits.joint_max_rad + MEASURED_SLACK_RAD,
        tether_m=limits.tether_m + MEASURED_SLACK_M,
        tether_rad=limits.tether_rad + MEASURED_SLACK_RAD,
    )

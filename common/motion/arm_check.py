"""Check of an arm: what may be commanded and measured under one lease. Pure.

The arbiter has one and the robot process has one: each with its own process, config and state.
Measurements and times are arguments. Every rule returns a `Trip`; an accepted command is within all
limits. Backing off is another set of limits for the same rules (common/motion/back_off.py).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import degrees, hypot, inf, radians
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion import back_off
from common.motion.back_off import LoadRatchet
from common.motion.convert import pose_of
from common.motion.frames import Array, interpolated, is_finite_pose
from common.motion.limits import (
    NS_PER_S,
    ArmBounds,
    Limits,
    check_apart,
    check_joints,
    check_speed,
    check_wrench,
    joint_goal,
)
from common.motion.setpoint_monitor import SetpointMonitor
from forcemesh.faults import tripped
from forcemesh.messages import Feedback, Goal, Joints, Purpose, Speed, Trip, WrenchAtTcp

# Tolerance of measured values beyond a limit on commands: rounding of reports, settling.
MEASURED_SLACK_M, MEASURED_SLACK_RAD = 2e-3, radians(0.5)
JOINT_WINDOW_NS = 100_000_000  # averaging window of joint speeds: samples repeat and have jitter
LONGEST_CENTRE_M = 0.3  # from the TCP to a contact point: beyond any tool
PATH_SAMPLES = 25
ROUNDING_M = 2e-4  # between two readings of an arm at rest
BACK_OFF_SLACK_M = 1e-3  # at least: such an arm begins at a limit; below the robot's own slack

FlangeAt = Callable[[Array], pin.SE3]


class Slack(NamedTuple):
    """How far the measured arm may be beyond the limits on commands."""

    position_m: float = 0.0
    rotation_rad: float = 0.0
    joint_speed: float | None = None  # share of what the joints can do; None: the limit


ARBITER_SLACK = Slack()  # it reports first
ROBOT_SLACK = Slack(MEASURED_SLACK_M, MEASURED_SLACK_RAD, joint_speed=1.1)


@dataclass(slots=True)
class JointTrack:
    """Measured joint angles of the last tenth of a second: time [ns] and angles [rad]."""

    samples: deque[tuple[int, Joints | Array]] = field(default_factory=deque)

    def add(self, stamp_ns: int, joint_rad: Joints | Array) -> None:
        """Add a sample; one that is not newer changes nothing."""
        samples = self.samples
        if not samples or stamp_ns > samples[-1][0]:
            samples.append((stamp_ns, tuple(joint_rad)))
            while len(samples) > 1 and samples[1][0] <= stamp_ns - JOINT_WINDOW_NS:
                samples.popleft()

    @property
    def speed_rad_s(self) -> list[float] | None:
        """Mean speed of each joint over the window; None before the window is full."""
        if not self.samples:
            return None
        (from_ns, q_from), (to_ns, q_to) = self.samples[0], self.samples[-1]
        if to_ns - from_ns < JOINT_WINDOW_NS:
            return None
        time_s = (to_ns - from_ns) / NS_PER_S
        return [(end - start) / time_s for start, end in zip(q_from, q_to, strict=True)]


class ArmCheck:
    """Limit check of commands and of the measured arm, with the limits of this cell."""

    def __init__(
        self, cell: CellConfig, slack: Slack = ROBOT_SLACK, flange_at: FlangeAt | None = None
    ) -> None:
        """Store the cell's limits; nothing is allowed before `start`.

        Args:
            cell: The cell file.
            slack: Tolerance of the measured arm.
            flange_at: Forward kinematics from joint angles [rad], if the arm's geometry is known:
                joint moves are then also checked by the path of the tool.
        """
        self._limits = limits = Limits.of(cell)
        self._slack = slack
        self._fastest_rad_s = limits.joint_speed_rad_s.tolist()
        if slack.joint_speed is not None:
            can_rad_s = np.radians(cell.robot.joint_speed_max_deg_s)
            self._fastest_rad_s = (slack.joint_speed * can_rad_s).tolist()
        self._setpoint_max_N = cell.force.setpoint_max_N
        self._flange_at = flange_at
        # Of commands under the present lease; no tether before one.
        untethered = replace(limits, tether_m=inf, tether_rad=inf)
        T_flange_tcp: pin.SE3 = cell.tool.T_flange_tcp.pose
        self.bounds = ArmBounds(untethered, T_flange_tcp, pin.SE3.Identity())
        self._wide = self._widened(slack.position_m)
        self._backs_off = False  # under a lease for that
        self._since_ns: int | None = None  # first report under it
        # The refusal of every command: before a lease; of all others under a lease for backing off.
        self._refusal: Trip | None = tripped("no_lease", "no lease has begun")
        self._load: LoadRatchet | None = None  # of the move under way, or of backing off
        self._wrench: WrenchAtTcp | None = None
        self._monitor = SetpointMonitor(limits)
        self._joints = JointTrack()

    def start(self, T_base_flange: pin.SE3, purpose: Purpose = "all") -> None:
        """Begin a lease: the tether starts at the present pose.

        A lease for `back_off` has its own limits (common/motion/back_off.py) until the next lease.
        """
        T_armed, limits, slack_m = T_base_flange.copy(), self._limits, self._slack.position_m
        self._since_ns = self._load = self._refusal = None
        self._backs_off = purpose == "back_off"
        if self._backs_off:
            text = "the arm was armed to back off: it accepts only that goal"
            self._refusal = tripped("state", text)
            self._load = LoadRatchet()
            T_base_tcp = T_armed * self.bounds.T_flange_tcp
            limits = back_off.relaxed_limits(limits, T_base_tcp, ROUNDING_M)
            slack_m = max(slack_m, BACK_OFF_SLACK_M)
        self.bounds = replace(self.bounds, limits=limits, T_armed=T_armed)
        self._wide = self._widened(slack_m)

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
        if self._backs_off:
            trip = self._back_off_trip(goal, speed, T_measured)
        else:
            trip = (
                self._refusal
                or check_speed(self._limits, speed)
                or self.bounds.goal(goal, joint_rad)
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

    def place(self, T_target: pin.SE3) -> Trip | None:
        """Check the flange pose of a set point: TCP in the workspace, flange within the tether."""
        return self._refusal or self.bounds.place(T_target)

    # --- the measured arm -------------------------------------------------------------------------

    def wrench(self, wrench: WrenchAtTcp | None, *, in_move: bool = False) -> Trip | None:
        """Check the wrench, if known; in a move and while backing off it must not rise much.

        Call it for every wrench: the load counts from the lowest one of the motion.
        """
        self._wrench = wrench
        if not (in_move or self._backs_off):
            self._load = None
        if wrench is None:
            return None
        trip = check_wrench(self.bounds.limits, wrench.force_N, wrench.torque_Nm)
        if trip is not None or not (self._backs_off or (in_move and wrench.calibrated)):
            return trip
        load = self._load or LoadRatchet(rise_N=self._limits.move_rise_N, rise_Nm=inf)
        motion = "while backing off" if self._backs_off else "in the move: limits.move_rise_N"
        self._load, trip = load.after(wrench, motion)
        return trip

    def arm(
        self,
        T_measured: pin.SE3,
        joint_rad: Joints | Array,
        stamp_ns: int,
        *,
        now_ns: int | None = None,
    ) -> Trip | None:
        """Check joint angles, pose and joint speeds of the arm; call it for every report.

        Joint moves have no end pose that could be checked before, so the measured pose is checked.

        Args:
            T_measured: Flange pose in base.
            joint_rad: Joint angles [rad].
            stamp_ns: Of the report, by the robot's clock: joint speeds count by it.
            now_ns: By the own clock; None: it is the same.
        """
        trip = check_joints(self._limits, joint_rad, slack_rad=MEASURED_SLACK_RAD)
        if trip is None:
            self._joints.add(stamp_ns, joint_rad)
        trip = trip or self._wide.place(T_measured) or self._joint_speed_trip()
        if trip is None and self._backs_off and self._load is not None:
            at_ns = stamp_ns if now_ns is None else now_ns
            self._since_ns = at_ns if self._since_ns is None else self._since_ns
            time_s = max(0, at_ns - self._since_ns) / NS_PER_S
            trip = back_off.motion_trip(self.bounds.T_armed, T_measured, time_s, self._load)
        return trip

    # --- inside -----------------------------------------------------------------------------------

    def _joint_speed_trip(self) -> Trip | None:
        if (speed_rad_s := self._joints.speed_rad_s) is None:
            return None
        both = zip(map(abs, speed_rad_s), self._fastest_rad_s, strict=True)
        for number, (speed, fastest) in enumerate(both, start=1):
            if speed > fastest:
                text = f"joint {number} turns at {degrees(speed):.0f} degrees/s"
                return tripped("joint_speed", text, value=speed, limit=fastest, unit="rad/s")
        return None

    def _back_off_trip(self, goal: Goal, speed: Speed, T_measured: pin.SE3) -> Trip | None:
        """Compare a goal with the path that this process computes itself."""
        if goal.kind != "pose" or goal.pose is None:
            return self._refusal
        limits, wrench = self._limits, self._wrench
        T_flange_tcp, T_goal = self.bounds.T_flange_tcp, pose_of(goal.pose)
        expected = back_off.plan(limits, T_measured, T_flange_tcp, wrench, confirmed=True)
        trip = back_off.goal_trip(expected, T_measured, T_goal, speed)
        trip = trip or check_speed(self.bounds.limits, speed)
        return trip or self.bounds.place(T_goal)

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
        return self.bounds.place(path[-1])

    def _widened(self, slack_m: float) -> ArmBounds:
        """Return the bounds of measured values: slightly wider than those of commands."""
        limits = self.bounds.limits
        wide = replace(
            limits,
            workspace_min_m=limits.workspace_min_m - slack_m,
            workspace_max_m=limits.workspace_max_m + slack_m,
            planes=tuple(
                replace(plane, point_m=plane.point_m - slack_m * plane.normal)
                for plane in limits.planes
            ),
            tether_m=limits.tether_m + slack_m,
            tether_rad=limits.tether_rad + self._slack.rotation_rad,
        )
        return replace(self.bounds, limits=wide)

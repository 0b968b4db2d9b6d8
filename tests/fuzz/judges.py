"""Independent reference check of the output of a robot's last check.

`CommandedPath` evaluates the commanded motion: travel and rotation in a time window, and
acceleration. Deceleration is not limited; all else is checked against the cell's limits and the
margins below.
"""

from bisect import bisect_right
from collections import Counter, deque
from itertools import islice
from math import acos, degrees, radians

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from controller.packet_table import Com, FeedbackSwitch
from tests.fuzz.framer import numbers
from tests.fuzz.permissive_arbiter import MOTIONS, pose_of_vec

Array = np.ndarray
MARGIN = 1.25  # of speed: set points may arrive slightly early
BURST_S = 0.05  # largest delay of a set point between check and output
ROUNDING_M = 1e-4
ROUNDING_RAD = 1e-3
SLACK_M = 3e-3  # of the commanded arm beyond the workspace during a move
SLACK_RAD = radians(1.0)  # the same for rotation
STILL_RAD = 1e-9  # per millisecond: rounding at rest
HALF_S = 0.06
SUDDEN, SOON_S = 1.5, 0.02  # margin of acceleration, and largest early start of a stream
TURN_ROUNDING_RAD = 2e-3  # per packet
BACK_OFF_M, BACK_OFF_M_S = 0.020, 0.005  # of a back-off lease: from its start
BRAKED_M = 0.010  # braking distance of the motion active at the start of such a lease
RELEASED_S = 0.25  # time to standstill after a force above the ceiling
WATCHED_MOTIONS = {*MOTIONS, Com.WRENCH}


def allowance() -> str:
    """Return the text of the tolerances beyond the cell's limits, as in docs/reliability.md."""
    return (
        f"way and turn of {MARGIN:g} times the speed limit over 250 ms and {1e3 * BURST_S:.0f} ms"
        f" beside; over {1e3 * HALF_S:.0f} ms {SUDDEN:g} times the acceleration and what"
        f" {1e3 * (SOON_S + BURST_S):.0f} ms at full speed are; on the way of a move of the"
        f" simulated arm {1e3 * SLACK_M:.0f} mm and {degrees(SLACK_RAD):.0f} degree;"
        f" {1e3 * RELEASED_S:.0f} ms to come to rest after a force above the ceiling"
    )


def _angle(trace: float) -> float:
    return acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


def turned(T_from: pin.SE3, T_to: pin.SE3) -> float:
    """Return the angle between two poses [rad]."""
    return _angle(float(np.sum(T_from.rotation * T_to.rotation)))


class CommandedPath:
    """Commanded flange motion over time."""

    def __init__(self, cell: CellConfig) -> None:
        """Start without points."""
        limits = cell.limits
        self._speed, self._turning = limits.speed_m_s, radians(limits.speed_deg_s)
        self._accel = limits.accel_m_s2
        self._times_s: deque[float] = deque()  # of the points of the last 250 ms, oldest first
        self._travels_m: deque[float] = deque()  # travel up to each of them
        self._turns_rad: deque[float] = deque()
        self._last: tuple[Array, Array] | None = None
        self.most_m_s = self.most_m = self.most_m_s2 = 0.0

    def jump(self) -> None:
        """Restart the path: the next point is its first."""
        self._last = None

    def add(self, at_s: float, p_m: Array, R: Array) -> list[str]:
        """Add a point; return the limits that it violates."""
        times_s, travels_m, turns_rad = self._times_s, self._travels_m, self._turns_rad
        travel_m = turn_rad = 0.0
        if self._last is not None:
            travel_m = float(np.linalg.norm(p_m - self._last[0]))
            trace = float(np.sum(self._last[1] * R))
            turn_rad = _angle(trace)
        self._last = (p_m, R)
        times_s.append(at_s)
        travels_m.append(travel_m)
        turns_rad.append(turn_rad)
        while at_s - times_s[0] > 0.25:
            for column in (times_s, travels_m, turns_rad):
                column.popleft()
        count, window_m, window_rad = len(times_s), sum(travels_m), sum(turns_rad)
        self.most_m = max(self.most_m, window_m)
        broken = []
        if window_m > MARGIN * self._speed * (0.25 + BURST_S) + ROUNDING_M * count:
            broken.append("window")
        if window_rad > MARGIN * self._turning * (0.25 + BURST_S) + TURN_ROUNDING_RAD * count:
            broken.append("turning")
        return broken + self._sudden(at_s)

    def _sudden(self, at_s: float) -> list[str]:
        """Compare the travel of the last 60 ms with that of the 60 ms before."""
        first, middle = (self._count_older(at_s, age_s) for age_s in (2 * HALF_S, HALF_S))
        newer = sum(islice(self._travels_m, middle, None))
        older = sum(islice(self._travels_m, first, middle))
        change = newer - older
        self.most_m_s = max(self.most_m_s, newer / HALF_S)
        self.most_m_s2 = max(self.most_m_s2, change / HALF_S**2)
        if change > SUDDEN * self._accel * HALF_S**2 + self._speed * (SOON_S + BURST_S):
            return ["acceleration"]
        return []

    def _count_older(self, at_s: float, age_s: float) -> int:
        """Return the number of points at least as old as `age_s`, to the microsecond."""
        return bisect_right(self._times_s, -age_s, key=lambda then_s: -round(at_s - then_s, 6))


class ArmJudge:
    """Checks the commanded joints of an arm with known kinematics, each millisecond."""

    def __init__(self, cell: CellConfig) -> None:
        """Start without commands."""
        self.broken: Counter[str] = Counter()
        self.path = CommandedPath(cell)
        limits = cell.limits
        self._low = np.array(limits.workspace_min_m) - SLACK_M
        self._high = np.array(limits.workspace_max_m) + SLACK_M
        self._tether_m = limits.tether_m + SLACK_M
        self._tether_rad = radians(limits.tether_deg) + SLACK_RAD
        self._joints = (np.radians(cell.robot.joint_min_deg), np.radians(cell.robot.joint_max_deg))
        self._fastest = np.radians(cell.robot.joint_speed_max_deg_s) * 1e-3
        self._q: Array | None = None
        self._start: pin.SE3 | None = None
        self._lease: object = None
        self._above_s: float | None = None
        self._since_s, self._backs_off = 0.0, False

    def check(
        self,
        at_s: float,
        q: Array,
        flange: pin.SE3,
        tcp_m: Array,
        *,
        lease: object,
        backs_off: bool,
    ) -> None:
        """Check one millisecond; `lease` is the one in force as reported by the robot, or None."""
        note = self.broken.update
        if ((q < self._joints[0] - 1e-9) | (q > self._joints[1] + 1e-9)).any():
            note(["joint"])
        if self._q is not None and (np.abs(q - self._q) > self._fastest + 1e-9).any():
            note(["joint speed"])
        if ((tcp_m < self._low) | (tcp_m > self._high)).any():
            note(["workspace"])
        if lease is not None and lease != self._lease:
            self._lease, self._start, self._since_s = lease, flange.copy(), at_s
            self._backs_off = backs_off
        if self._start is not None:
            away_m = float(np.linalg.norm(flange.translation - self._start.translation))
            away_rad = turned(self._start, flange)
            if lease is not None and (away_m > self._tether_m or away_rad > self._tether_rad):
                note(["tether"])
            most_m = BRAKED_M + min(MARGIN * BACK_OFF_M_S * (at_s - self._since_s), BACK_OFF_M)
            if self._backs_off and away_m > most_m:
                note(["back off"])
        moved = self._q is None or bool((np.abs(q - self._q) > STILL_RAD).any())
        released = self._above_s is not None and at_s - self._above_s > RELEASED_S
        if released and moved and not self._backs_off:
            note(["force"])
        note(self.path.add(at_s, flange.translation.copy(), flange.rotation.copy()))
        self._q = q

    def force(self, at_s: float, *, above: bool) -> None:
        """Set whether the wrench available to the robot is above the ceiling."""
        self._above_s = (at_s if self._above_s is None else self._above_s) if above else None


class PacketJudge:
    """Checks the packets sent by a gateway."""

    def __init__(self, cell: CellConfig) -> None:
        """Start without packets."""
        assert cell.gateway is not None
        self.broken: Counter[str] = Counter()
        self.coms: Counter[int] = Counter()
        self.path = CommandedPath(cell)
        self._cell, limits, section = cell, cell.limits, cell.gateway
        self._limits = limits
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._scales = (
            section.position_per_mm, section.oat_per_deg, section.joint_per_deg,
            section.force_per_N, section.torque_per_Nm, section.speed_per_mm_s,
        )  # fmt: skip
        self._low, self._high = np.array(limits.workspace_min_m), np.array(limits.workspace_max_m)
        self._kept: tuple[int, ...] | None = None
        self.start: pin.SE3 | None = None  # pose of the arm at the start of the lease

    def packet(
        self, at_s: float, chars: bytes, *, kind: str, may_move: bool, T: pin.SE3, q: Array
    ) -> None:
        """Check one packet.

        Args:
            at_s: Time of sending [s].
            chars: The packet.
            kind: Kind of the command in force as reported by the gateway.
            may_move: A permitted command is fresh, and no force is above the ceiling.
            T: Flange pose reported by the controller.
            q: Joint angles reported by the controller [rad].
        """
        found = numbers(chars)
        if found is None:
            self.broken.update(["not a packet"])
            return
        com, param, vec = Com(found[1]), found[2], found[3:]
        self.coms[int(com)] += 1
        starts = com == Com.FEEDBACK and param != FeedbackSwitch.STOP
        if (com in WATCHED_MOTIONS or starts) and not may_move:
            self.broken.update(["moved without leave"])
        if com in {Com.MOVE_POSE, Com.SET_POINT}:
            self._pose(at_s, vec, T, is_stream=kind == "setpoint")
        elif com in {Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS}:
            self.path.jump()
            joints = np.array(vec) / self._scales[2]
            self._joints(joints + np.degrees(q) * (com == Com.MOVE_BY_JOINTS))
        elif com == Com.SPEEDS:
            speed = vec[3] / self._scales[5] * 1e-3 * vec[2] / 1e4
            self._note("speed", speed > self._limits.speed_m_s + 1e-4)
        elif com == Com.LIMITS:
            self._kept = vec
        elif com == Com.TCP:
            lever = np.array(vec[:3]) / self._scales[0] * 1e-3 - self._T_flange_tcp.translation
            self._note("lever", bool(np.linalg.norm(lever) > 0.301))
        elif com in {Com.WRENCH, Com.FORCE_SET_POINT}:
            self._force(com, vec)
        elif starts:
            self.path.jump()
            self._note("feedback without limits", self._kept is None)

    def _force(self, com: Com, vec: tuple[int, ...]) -> None:
        """Check a force reading, or the set point of force feedback."""
        force_N = float(np.linalg.norm(vec[:3])) / self._scales[3]
        is_reading = com == Com.WRENCH
        most_N = self._limits.force_N if is_reading else self._cell.force.setpoint_max_N
        self._note("force" if is_reading else "set point", force_N > most_N + 0.1)

    def _pose(self, at_s: float, vec: tuple[int, ...], T_now: pin.SE3, *, is_stream: bool) -> None:
        T = pose_of_vec(vec, self._scales)
        tcp_m = (T * self._T_flange_tcp).translation
        outside = (tcp_m < self._low - ROUNDING_M) | (tcp_m > self._high + ROUNDING_M)
        self._note("workspace", bool(outside.any()))
        if self.start is not None:
            away_m = float(np.linalg.norm(T.translation - self.start.translation))
            self._note("tether", away_m > self._limits.tether_m + ROUNDING_M)
            most_rad = radians(self._limits.tether_deg) + ROUNDING_RAD
            self._note("tether", turned(self.start, T) > most_rad)
        if not is_stream:
            self.path.jump()
            return
        step_m = float(np.linalg.norm(T.translation - T_now.translation))
        most_m = self._limits.step_m + self._limits.speed_m_s * BURST_S + ROUNDING_M
        self._note("step", step_m > most_m)
        self.broken.update(self.path.add(at_s, T.translation.copy(), T.rotation.copy()))

    def _joints(self, joint_deg: Array) -> None:
        robot = self._cell.robot
        low, high = np.array(robot.joint_min_deg) - 0.01, np.array(robot.joint_max_deg) + 0.01
        self._note("joint", bool(((joint_deg < low) | (joint_deg > high)).any()))

    def _note(self, name: str, is_broken: bool) -> None:
        if is_broken:
            self.broken.update([name])

"""Monitors of the inputs over time, with debounce: rest, residual force, calibration, alignment.

Pure. Each monitor receives every snapshot once, in order, with bounded memory.
"""

from dataclasses import replace
from math import hypot

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import is_finite_pose, length, rotation_between
from common.runtime.overruns import ALLOWED_SHARE, MOST_OVERRUNS, Overruns, allowed_gap_s
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.arbiter.controller_watch import ControllerWatch
from services.arbiter.inputs import Inputs, Watched, overrun_trip

REST_POSE_S = 0.2  # least time of the flange at one pose
REST_POSITION_M = 2e-4
REST_TURN_RAD = 2e-3
RESIDUAL_S = 0.5
STALL_S = 1.0  # stall of the arbiter after which all inputs look stale
MISALIGNED_PAIRS = 2  # debounce: one pair may straddle a message in transit


class InputMonitors:
    """Set of all monitors."""

    def __init__(self, cell: CellConfig) -> None:
        """Start without snapshots."""
        self._overruns = Overruns(allowed_gap_s(cell, "arbiter"))
        self._rest = RestWatch(1.0 / cell.rates.robot_hz)
        self._residual = ResidualWatch(cell.force.idle_max_N, cell.force.idle_max_Nm)
        self._calibration = CalibrationWatch()
        self._controller = ControllerWatch(cell)
        stale_s = [cell.stale_after_s(topic) for topic in (topics.ROBOT_STATE, topics.WRENCH)]
        self._alignment = AlignmentWatch(ALLOWED_SHARE * max(stale_s))

    def update(self, inputs: Inputs) -> Inputs:
        """Return the snapshot with the findings of all monitors."""
        self._overruns.stepped(inputs.now_ns)
        faults = [self._alignment.update(inputs)]
        if self._overruns.gap_s > STALL_S:
            text = (
                f"the arbiter itself stalled for {self._overruns.gap_s:.1f} s and received nothing"
            )
            faults.append(tripped("overrun", text))
        if self._overruns.count > MOST_OVERRUNS:
            faults.append(overrun_trip("arbiter", self._overruns.count, self._overruns.longest_s))
        watched = Watched(
            faults=tuple(trip for trip in faults if trip is not None),
            motion_at_rest_violation=self._rest.update(inputs),
            residual=self._residual.update(inputs),
            calibration=self._calibration.update(inputs),
            slow=self._controller.start_trip(inputs),
            slower=self._controller.update(inputs),
        )
        return replace(inputs, watched=watched)


class RestWatch:
    """Monitor of rest: the flange stays at one pose, which while holding is the commanded one."""

    def __init__(self, robot_period_s: float) -> None:
        """Start without a time at rest."""
        self._needed_ns = round(max(REST_POSE_S, 3.0 * robot_period_s) * NS_PER_S)
        self._anchor: pin.SE3 | None = None
        self._since_ns = 0

    def update(self, inputs: Inputs) -> Trip | None:
        """Return why the arm does not count as at rest."""
        robot = inputs.robot.fresh
        if robot is None:
            self._anchor = None
            return None  # a missing robot state is reported by `inputs.missing`
        T = pose_of(robot)
        if self._anchor is None or robot.status.moving or _is_away(self._anchor, T):
            self._anchor, self._since_ns = T, inputs.now_ns
        rest_s = (inputs.now_ns - self._since_ns) / NS_PER_S
        needed_s = self._needed_ns / NS_PER_S
        if rest_s >= needed_s:
            return None
        text = f"the arm has been at rest for {rest_s:.2f} s, {needed_s:.2f} s are required"
        return tripped("moving", text, value=rest_s, limit=needed_s, unit="s")


def _is_away(T_anchor: pin.SE3, T: pin.SE3) -> bool:
    if not (is_finite_pose(T) and is_finite_pose(T_anchor)):
        return True
    away_m = length(T.translation - T_anchor.translation)
    if away_m > REST_POSITION_M:
        return True
    turn_rad = rotation_between(T_anchor.rotation, T.rotation)
    return length(turn_rad) > REST_TURN_RAD


class ResidualWatch:
    """Monitor of the residual force in free space, which a wrong payload or bias causes.

    A contact found by the regulator is expected: until it ends, the last result in free space is
    kept. A tare and a restarted wrench service reset the monitor: no contact is expected then.
    """

    def __init__(self, limit_N: float, limit_Nm: float) -> None:
        """Start without a result."""
        self._limit_N, self._limit_Nm = limit_N, limit_Nm
        self._source: tuple[int, str] | None = None  # publisher and calibration
        self._in_contact = False
        self._above_since_ns: int | None = None
        self._verdict: Trip | None = None

    def update(self, inputs: Inputs) -> Trip | None:
        """Return the trip of a residual above its limit, None while it is below."""
        wrench, header = inputs.wrench.fresh, inputs.wrench.header
        if wrench is None or header is None:
            self._above_since_ns = None
            return self._verdict
        source = (header.epoch, wrench.calibration)
        if source != self._source:
            self._source, self._in_contact = source, False
            self._verdict = self._above_since_ns = None
        target = inputs.target.fresh
        if target is not None and target.contact == "contact":
            self._in_contact = True
        force_N, torque_Nm = hypot(*wrench.force_N), hypot(*wrench.torque_Nm)
        if force_N <= self._limit_N and torque_Nm <= self._limit_Nm:
            self._in_contact = self._in_contact and target is not None
            self._verdict = self._above_since_ns = None
        elif self._in_contact:
            self._above_since_ns = None
        else:
            self._judge(force_N, torque_Nm, inputs.now_ns)
        return self._verdict

    def _judge(self, force_N: float, torque_Nm: float, now_ns: int) -> None:
        if self._above_since_ns is None:
            self._above_since_ns = now_ns
        if now_ns - self._above_since_ns >= RESIDUAL_S * NS_PER_S:
            is_force = force_N > self._limit_N
            residual_text = f"{force_N:.1f} N are" if is_force else f"{torque_Nm:.2f} N m are"
            text = (
                f"{residual_text} left where nothing should be touched: tare in free space; "
                "in contact, arm for jog, then `forcemesh retract`"
            )
            value, limit = (force_N, self._limit_N) if is_force else (torque_Nm, self._limit_Nm)
            unit = "N" if is_force else "N m"
            self._verdict = tripped("payload", text, value=value, limit=limit, unit=unit)


class CalibrationWatch:
    """Monitor of a calibration that changes while force feedback runs.

    A tare or another payload is a step of the force, to which the regulator would react by motion.
    """

    def __init__(self) -> None:
        """Start without force feedback."""
        self._at_start: str | None = None

    def update(self, inputs: Inputs) -> Trip | None:
        """Return why running force feedback must end."""
        wrench, target = inputs.wrench.fresh, inputs.target.fresh
        if target is None or wrench is None:
            self._at_start = None if target is None else self._at_start
            return None
        if self._at_start is None:
            self._at_start = wrench.calibration
        if not wrench.calibrated:
            return tripped(
                "calibration", wrench.calibration_fault or "the wrench is not calibrated"
            )
        if wrench.calibration == self._at_start:
            return None
        text = f"the calibration became {wrench.calibration!r}, it was {self._at_start!r}"
        return tripped("calibration", f"{text} when force feedback began")


class AlignmentWatch:
    """Monitor of the time offset between a wrench's sample and the robot's pose.

    Checked only when both are new: a publisher that stops is detected by its age.
    """

    def __init__(self, limit_s: float) -> None:
        """Start without snapshots.

        Args:
            limit_s: Two periods of the slower topic, with the default deadlines of the bus.
        """
        self._limit_s = limit_s
        self._last_seq = (0, 0)  # seq of robot and wrench at the last pair
        self._bad_pairs = 0
        self._trip: Trip | None = None  # of the last pair

    def update(self, inputs: Inputs) -> Trip | None:
        """Return why pose and wrench do not match in time."""
        robot, wrench, sensor = inputs.robot.header, inputs.wrench.header, inputs.sensor.header
        origin = inputs.wrench.origin
        if robot is None or wrench is None or sensor is None or origin is None:
            return None
        if not robot.boot == wrench.boot == sensor.boot:
            return None  # stamps of different clocks cannot be subtracted
        offset_s = (robot.stamp_ns - origin.stamp_ns) / NS_PER_S
        if robot.seq != self._last_seq[0] and wrench.seq != self._last_seq[1]:
            self._last_seq = (robot.seq, wrench.seq)
            self._bad_pairs = self._bad_pairs + 1 if abs(offset_s) > self._limit_s else 0
            self._trip = self._trip_of(offset_s)
        return self._trip

    def _trip_of(self, offset_s: float) -> Trip | None:
        if self._bad_pairs < MISALIGNED_PAIRS:
            return None
        older = "wrench" if offset_s > 0.0 else "robot/state"
        text = (
            f"{older} is {abs(offset_s) * 1e3:.0f} ms older: pose and wrench do not match in time"
        )
        return tripped("misaligned", text, value=abs(offset_s), limit=self._limit_s, unit="s")

"""What is wrong with the inputs that one look cannot show: it takes a while. Pure.

Each watcher is shown every snapshot once, in order, and keeps no more than it needs.
"""

from dataclasses import replace
from math import hypot

import pinocchio as pin

from common.config.cell import Cell
from common.motion.convert import pose_of
from common.motion.frames import is_finite_pose, length, rotation_between
from common.runtime.overruns import ALLOWED_SHARE, MOST_OVERRUNS, Overruns, allowed_gap_s
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.arbiter.controller_watch import ControllerWatch
from services.arbiter.inputs import Inputs, Watched, overrun_trip

REST_S = 0.2  # so long the flange must have stayed where it is
REST_POSITION_M = 2e-4
REST_TURN_RAD = 2e-3
RESIDUAL_S = 0.5
STOOD_STILL_S = 1.0  # after which all the others look silent, and are not to blame
MISALIGNED_PAIRS = 2  # one pair may have met a message on its way


class Watch:
    """All watchers, in one."""

    def __init__(self, cell: Cell) -> None:
        """Begin with nothing seen."""
        self._own = Overruns(allowed_gap_s(cell, "arbiter"))
        self._rest = RestWatch(1.0 / cell.rates.robot_hz)
        self._residual = ResidualWatch(cell.force.idle_max_N, cell.force.idle_max_Nm)
        self._calibration = CalibrationWatch()
        self._controller = ControllerWatch(cell)
        stale_s = [cell.stale_after_s(topic) for topic in (topics.ROBOT_STATE, topics.WRENCH)]
        self._alignment = AlignmentWatch(ALLOWED_SHARE * max(stale_s))

    def see(self, inputs: Inputs) -> Inputs:
        """Return the snapshot with what all snapshots so far have shown."""
        self._own.stepped(inputs.now_ns)
        faults = [self._alignment.see(inputs)]
        if self._own.gap_s > STOOD_STILL_S:
            text = f"the arbiter itself stood still for {self._own.gap_s:.1f} s and heard nobody"
            faults.append(tripped("overrun", text))
        if self._own.count > MOST_OVERRUNS:
            faults.append(overrun_trip("arbiter", self._own.count, self._own.longest_s))
        watched = Watched(
            faults=tuple(trip for trip in faults if trip is not None),
            unrest=self._rest.see(inputs),
            residual=self._residual.see(inputs),
            calibration=self._calibration.see(inputs),
            slow=self._controller.unfit(inputs),
            slower=self._controller.see(inputs),
        )
        return replace(inputs, watched=watched)


class RestWatch:
    """Whether the arm is where it was commanded: while it holds, that is where it is, at rest."""

    def __init__(self, robot_period_s: float) -> None:
        """Begin with an arm that nobody has seen resting."""
        self._needed_ns = round(max(REST_S, 3.0 * robot_period_s) * NS_PER_S)
        self._anchor: pin.SE3 | None = None
        self._since_ns = 0

    def see(self, inputs: Inputs) -> Trip | None:
        """Return why the arm does not count as resting."""
        robot = inputs.robot.fresh
        if robot is None:
            self._anchor = None
            return None  # that it is not heard is said elsewhere
        T = pose_of(robot)
        if self._anchor is None or robot.status.moving or _is_away(self._anchor, T):
            self._anchor, self._since_ns = T, inputs.now_ns
        rest_s = (inputs.now_ns - self._since_ns) / NS_PER_S
        needed_s = self._needed_ns / NS_PER_S
        if rest_s >= needed_s:
            return None
        text = f"the arm rests for {rest_s:.2f} s, {needed_s:.2f} s are needed"
        return tripped("moving", text, value=rest_s, limit=needed_s)


def _is_away(T_anchor: pin.SE3, T: pin.SE3) -> bool:
    if not (is_finite_pose(T) and is_finite_pose(T_anchor)):
        return True
    away_m = length(T.translation - T_anchor.translation)
    if away_m > REST_POSITION_M:
        return True
    turn_rad = rotation_between(T_anchor.rotation, T.rotation)
    return length(turn_rad) > REST_TURN_RAD


class ResidualWatch:
    """What is left of the force in free space: more than a little is a wrong payload or bias.

    Contact that the regulator found is expected: until it has ended, the verdict on the last free
    space stays. A tare and a restarted wrench service begin anew: nothing is expected then.
    """

    def __init__(self, limit_N: float, limit_Nm: float) -> None:
        """Begin with nothing known."""
        self._limit_N, self._limit_Nm = limit_N, limit_Nm
        self._source: tuple[int, str] | None = None  # writer and calibration
        self._in_contact = False
        self._above_since_ns: int | None = None
        self._verdict: Trip | None = None

    def see(self, inputs: Inputs) -> Trip | None:
        """Return what is left in free space, None while it is little."""
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
            left = f"{force_N:.1f} N are" if is_force else f"{torque_Nm:.2f} N m are"
            text = (
                f"{left} left where nothing should be touched: tare in free space; "
                "in contact, arm for jog, then `forcemesh retract`"
            )
            value, limit = (force_N, self._limit_N) if is_force else (torque_Nm, self._limit_Nm)
            self._verdict = tripped("payload", text, value=value, limit=limit)


class CalibrationWatch:
    """Whether force feedback still relies on the calibration that it began with.

    A tare or another payload is a step of the force: a regulator would answer it with motion.
    """

    def __init__(self) -> None:
        """Begin with no force feedback."""
        self._at_start: str | None = None

    def see(self, inputs: Inputs) -> Trip | None:
        """Return why a running force feedback must end."""
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
    """Whether the sample behind a wrench and the robot's pose are of about the same time.

    Judged only when both have moved on: a writer that falls silent is found by its age.
    """

    def __init__(self, limit_s: float) -> None:
        """Begin with nothing seen.

        Args:
            limit_s: Two periods of the slower one, in a cell on the bus's usual deadlines.
        """
        self._limit_s = limit_s
        self._seen = (0, 0)  # seq of robot and wrench at the last pair
        self._bad_pairs = 0
        self._trip: Trip | None = None  # of the last pair

    def see(self, inputs: Inputs) -> Trip | None:
        """Return why pose and wrench do not belong together."""
        robot, wrench, sensor = inputs.robot.header, inputs.wrench.header, inputs.sensor.header
        origin = inputs.wrench.origin
        if robot is None or wrench is None or sensor is None or origin is None:
            return None
        if not robot.boot == wrench.boot == sensor.boot:
            return None  # stamps of different clocks cannot be subtracted
        apart_s = (robot.stamp_ns - origin.stamp_ns) / NS_PER_S
        if robot.seq != self._seen[0] and wrench.seq != self._seen[1]:
            self._seen = (robot.seq, wrench.seq)
            self._bad_pairs = self._bad_pairs + 1 if abs(apart_s) > self._limit_s else 0
            self._trip = self._trip_of(apart_s)
        return self._trip

    def _trip_of(self, apart_s: float) -> Trip | None:
        if self._bad_pairs < MISALIGNED_PAIRS:
            return None
        older = "wrench" if apart_s > 0.0 else "robot/state"
        text = f"{older} is {abs(apart_s) * 1e3:.0f} ms older than the other of pose and wrench"
        return tripped("misaligned", text, value=abs(apart_s), limit=self._limit_s)

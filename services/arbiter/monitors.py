"""Monitors of the inputs over time: rest, residual force, alignment, and conditions of feedback.

Pure. Each monitor receives every snapshot once, in order, with bounded memory.
"""

from math import dist, hypot, sin

from common.config.cell import CellConfig
from common.motion.unexplained import REST_POSITION_M, REST_TURN_RAD
from common.runtime.overruns import ALLOWED_SHARE, MOST_OVERRUNS, Overruns, allowed_gap_s
from control.monitors import unchecked_axes
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import RobotState, Trip
from services.arbiter.inputs import Inputs, Monitored, overrun_trip

REST_CHORD = 2.0 * sin(REST_TURN_RAD / 4.0)  # between unit quaternions
RESIDUAL_S = 0.5
STALL_S = 1.0  # stall of the arbiter after which all inputs look stale
MISALIGNED_PAIRS = 2  # debounce: one pair may straddle a message in transit
# The limit of a running loop is wider than that of a start: the gain rule tolerates half the delay
# more, and a hold in contact costs more than a refused arming.
RUNNING_MARGIN = 1.5
SPEED_NOISE = 0.005  # of the monitor speed, which the pendant sets in whole percent
STREAMED, MONITOR = "streamed_round_trip_p50_s", "monitor_speed_fraction"


class InputMonitors:
    """Set of all monitors."""

    def __init__(self, cell: CellConfig) -> None:
        """Start without snapshots."""
        self._overruns = Overruns(allowed_gap_s(cell, "arbiter"))
        self._rest = RestMonitor()
        self._residual = ResidualMonitor(cell.force.idle_max_N, cell.force.idle_max_Nm)
        self._feedback = FeedbackMonitor(cell)
        stale_s = [cell.stale_after_s(topic) for topic in (topics.ROBOT_STATE, topics.WRENCH)]
        self._alignment = AlignmentMonitor(ALLOWED_SHARE * max(stale_s))

    def update(self, inputs: Inputs) -> None:
        """Add the findings of all monitors to the snapshot."""
        overruns = self._overruns
        overruns.stepped(inputs.now_ns)
        misaligned = self._alignment.update(inputs)
        faults = [] if misaligned is None else [misaligned]
        if overruns.gap_s > STALL_S:
            text = f"the arbiter itself stalled for {overruns.gap_s:.1f} s and received nothing"
            faults.append(tripped("overrun", text))
        if overruns.count > MOST_OVERRUNS:
            faults.append(overrun_trip("arbiter", overruns.count, overruns.longest_s))
        inputs.monitored = Monitored(
            faults,
            rest_s=self._rest.update(inputs),
            residual=self._residual.update(inputs),
            feedback=self._feedback.update(inputs),
        )


class RestMonitor:
    """Monitor of rest: the time for which the flange has stayed at one pose."""

    def __init__(self) -> None:
        """Start without a time at rest."""
        self._anchor: RobotState | None = None
        self._since_ns = 0

    def update(self, inputs: Inputs) -> float:
        """Return the time at rest [s], zero without a pose.

        The unit quaternions of two orientations that differ by a rotation of angle a are
        2 sin(a / 4) apart; q and -q are the same orientation.
        """
        robot = inputs.robot.fresh
        if robot is None:
            self._anchor = None
            return 0.0
        anchor = self._anchor
        if anchor is not None and not robot.status.moving:
            turn, (x, y, z, w) = anchor.orientation_xyzw, robot.orientation_xyzw
            chord = min(dist(turn, (x, y, z, w)), dist(turn, (-x, -y, -z, -w)))
            # A pose that is not finite never rests: its comparisons are false.
            if dist(anchor.position_m, robot.position_m) <= REST_POSITION_M and chord <= REST_CHORD:
                return (inputs.now_ns - self._since_ns) / NS_PER_S
        self._anchor, self._since_ns = robot, inputs.now_ns
        return 0.0


class ResidualMonitor:
    """Monitor of the residual force in free space, which a wrong payload or bias causes.

    A contact found by the regulator is expected: until it ends, the last result in free space is
    kept. A tare and a restarted wrench service reset the monitor: no contact is expected then.
    """

    def __init__(self, limit_N: float, limit_Nm: float) -> None:
        """Start without a result."""
        self._limit_N, self._limit_Nm = limit_N, limit_Nm
        self._source: tuple[int, str, bool] | None = None  # publisher, calibration, whether tared
        self._in_contact = False
        self._above_since_ns: int | None = None
        self._verdict: Trip | None = None

    def update(self, inputs: Inputs) -> Trip | None:
        """Return the trip of a residual above its limit, None while it is below."""
        wrench, header = inputs.wrench.fresh, inputs.wrench.header
        if wrench is None or header is None:
            self._above_since_ns = None
            return self._verdict
        source = (header.epoch, wrench.calibration, wrench.tared)
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


def _named(calibration: tuple[str, bool]) -> str:
    name, tared = calibration
    return f"{name}, tared" if tared else name


class FeedbackMonitor:
    """Monitor of what must not change while force feedback runs: calibration and controller speed.

    A tare or another payload is a step of the force, to which the regulator would react by motion.
    The gains rely on the delays of the cell file: the robot process publishes in its health
    `monitor_speed_fraction`, which multiplies every speed in the controller, and
    `streamed_round_trip_p50_s`, the median time from sending a set point to the report that the
    robot program has executed it. A robot without these numbers is not checked.
    """

    def __init__(self, cell: CellConfig) -> None:
        """Start without force feedback."""
        self._cell = cell
        self._calibration: tuple[str, bool] | None = None  # when force feedback began
        self._fraction: float | None = None

    def update(self, inputs: Inputs) -> Trip | None:
        """Return why running force feedback must end; called once per snapshot."""
        if inputs.target.fresh is None:
            self._calibration = self._fraction = None
            return None
        wrench, numbers = inputs.wrench.fresh, inputs.numbers("robot")
        fraction = numbers.get(MONITOR)
        self._fraction = started = fraction if self._fraction is None else self._fraction
        if wrench is not None:
            calibration = wrench.calibration, wrench.tared
            if self._calibration is None:
                self._calibration = calibration
            if not wrench.calibrated:
                text = wrench.calibration_fault or "the wrench is not calibrated"
                return tripped("calibration", text)
            if (unchecked := unchecked_axes(wrench)) is not None:
                return tripped("calibration", unchecked.text)
            if calibration != self._calibration:
                now, before = map(_named, (calibration, self._calibration))
                text = f"the calibration became {now}, it was {before} when force feedback began"
                return tripped("calibration", text)
        if fraction is not None and started is not None and abs(fraction - started) > SPEED_NOISE:
            text = (
                f"the controller's monitor speed became {100.0 * fraction:g} %, it was "
                f"{100.0 * started:g} % when force feedback began"
            )
            return tripped("monitor_speed", text, value=fraction, limit=started)
        return delay_trip(numbers, self._cell, RUNNING_MARGIN)


def slow_start_trip(inputs: Inputs, cell: CellConfig) -> Trip | None:
    """Return why force feedback must not start with this controller."""
    numbers = inputs.numbers("robot")
    fraction, stream_m_s = numbers.get(MONITOR), cell.limits.speed_m_s
    needed_m_s = cell.force.speed_max_m_s
    least_m_s = min(needed_m_s, stream_m_s) * (1.0 - SPEED_NOISE)
    if fraction is not None and fraction * stream_m_s < least_m_s:
        text = (
            f"the controller's monitor speed is {100.0 * fraction:g} %: set points are "
            f"followed at {1e3 * fraction * stream_m_s:.1f} mm/s, force.speed_max_m_s requires "
            f"{1e3 * needed_m_s:g} mm/s"
        )
        return tripped("monitor_speed", text, value=fraction)
    return delay_trip(numbers, cell, 1.0)


def delay_trip(numbers: dict[str, float], cell: CellConfig, margin: float) -> Trip | None:
    """Check the delay of streamed set points against that of the cell file times a margin."""
    took_s, allowed_s = numbers.get(STREAMED), cell.robot.delay_s + cell.robot.lag_s
    if took_s is None or took_s <= margin * allowed_s:
        return None
    text = (
        f"the controller executes a set point {took_s * 1e3:.0f} ms after it was sent, in the "
        f"median; robot.delay_s plus lag_s is {allowed_s * 1e3:.0f} ms"
    )
    return tripped("delay", text, value=took_s, limit=margin * allowed_s, unit="s")


class AlignmentMonitor:
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
        if robot is None or wrench is None or sensor is None or wrench.sensor_stamp_ns is None:
            return None
        if not robot.boot == wrench.boot == sensor.boot:
            return None  # stamps of different clocks cannot be subtracted
        offset_s = (robot.stamp_ns - wrench.sensor_stamp_ns) / NS_PER_S
        if robot.seq != self._last_seq[0] and wrench.seq != self._last_seq[1]:
            self._last_seq = (robot.seq, wrench.seq)
            self._bad_pairs = self._bad_pairs + 1 if abs(offset_s) > self._limit_s else 0
            self._trip = None
            if self._bad_pairs >= MISALIGNED_PAIRS:
                older, apart_s = "wrench" if offset_s > 0.0 else "robot/state", abs(offset_s)
                apart = f"{older} is {apart_s * 1e3:.0f} ms older"
                text = f"{apart}: pose and wrench do not match in time"
                limit_s = self._limit_s
                self._trip = tripped("misaligned", text, value=apart_s, limit=limit_s, unit="s")
        return self._trip

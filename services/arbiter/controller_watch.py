"""Whether the controller is as fast as the gains of this cell rely on. Pure.

The robot's process measures, in its health: `monitor_speed_fraction`, which multiplies every speed
in the controller, and `streamed_round_trip_p50_s`, from sending a set point to the report that the
robot program has taken it. A robot that has no such numbers is not judged.
"""

from common.config.cell import Cell
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.arbiter.inputs import Inputs

# A loop that runs is stopped later than one is refused: the gain rule leaves room for half the
# delay again, and a hold in contact costs more than an arming that waits.
RUNNING_MARGIN = 1.5
SPEED_NOISE = 0.005  # of the monitor speed, in whole percent on the pendant
STREAMED, MONITOR = "streamed_round_trip_p50_s", "monitor_speed_fraction"


class ControllerWatch:
    """Compares what the robot's process measures with the cell file, and with the start."""

    def __init__(self, cell: Cell) -> None:
        """Begin with no force feedback.

        Args:
            cell: Its robot.delay_s and lag_s, from a set point to the arm there, and its speeds.
        """
        self._allowed_s = cell.robot.delay_s + cell.robot.lag_s
        self._stream_m_s, self._needed_m_s = cell.limits.speed_m_s, cell.force.speed_max_m_s
        self._at_start: float | None = None

    def unfit(self, inputs: Inputs) -> Trip | None:
        """Return why force feedback should not begin with this controller."""
        numbers = _numbers(inputs)
        fraction = numbers.get(MONITOR)
        if fraction is not None and fraction * self._stream_m_s < min(
            self._needed_m_s, self._stream_m_s
        ) * (1.0 - SPEED_NOISE):
            followed_mm_s, needed_mm_s = 1e3 * fraction * self._stream_m_s, 1e3 * self._needed_m_s
            text = (
                f"the controller's monitor speed is {100.0 * fraction:g} %: set points are "
                f"followed with {followed_mm_s:.1f} mm/s, force.speed_max_m_s asks for "
                f"{needed_mm_s:g} mm/s"
            )
            return tripped("monitor_speed", text, value=fraction)
        return self._late(numbers.get(STREAMED), self._allowed_s)

    def see(self, inputs: Inputs) -> Trip | None:
        """Return why a running force feedback must end; call it once for every snapshot."""
        numbers, runs = _numbers(inputs), inputs.target.fresh is not None
        fraction = numbers.get(MONITOR)
        if not runs:
            self._at_start = None
            return None
        if self._at_start is None:
            self._at_start = fraction
        if (
            fraction is not None
            and self._at_start is not None
            and abs(fraction - self._at_start) > SPEED_NOISE
        ):
            text = (
                f"the controller's monitor speed became {100.0 * fraction:g} %, it was "
                f"{100.0 * self._at_start:g} % when force feedback began"
            )
            return tripped("monitor_speed", text, value=fraction, limit=self._at_start)
        return self._late(numbers.get(STREAMED), RUNNING_MARGIN * self._allowed_s)

    def _late(self, took_s: float | None, limit_s: float) -> Trip | None:
        if took_s is None or took_s <= limit_s:
            return None
        text = (
            f"the controller takes a set point {took_s * 1e3:.0f} ms after it was sent, in the "
            f"median; robot.delay_s and lag_s together are {self._allowed_s * 1e3:.0f} ms"
        )
        return tripped("delay", text, value=took_s, limit=limit_s)


def _numbers(inputs: Inputs) -> dict[str, float]:
    reading = inputs.health.get("robot")
    health = None if reading is None else reading.fresh
    return {} if health is None else health.numbers

"""Controller speed monitor: checks the delays that the gains of this cell rely on. Pure.

The robot process publishes in its health: `monitor_speed_fraction`, which multiplies every speed
in the controller, and `streamed_round_trip_p50_s`, the median time from sending a set point to the
report that the robot program has executed it. A robot without these numbers is not checked.
"""

from common.config.cell import CellConfig
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.arbiter.inputs import Inputs

# The limit of a running loop is wider than that of a start: the gain rule tolerates half the delay
# more, and a hold in contact costs more than a refused arming.
RUNNING_MARGIN = 1.5
SPEED_NOISE = 0.005  # of the monitor speed, which the pendant sets in whole percent
STREAMED, MONITOR = "streamed_round_trip_p50_s", "monitor_speed_fraction"


class ControllerWatch:
    """Comparison of the controller's numbers with the cell file and with their start values."""

    def __init__(self, cell: CellConfig) -> None:
        """Start without force feedback.

        Args:
            cell: robot.delay_s and lag_s, from a set point to the arm's response, and the speeds.
        """
        self._allowed_s = cell.robot.delay_s + cell.robot.lag_s
        self._stream_m_s, self._needed_m_s = cell.limits.speed_m_s, cell.force.speed_max_m_s
        self._at_start: float | None = None

    def start_trip(self, inputs: Inputs) -> Trip | None:
        """Return why force feedback must not start with this controller."""
        numbers = _numbers(inputs)
        fraction = numbers.get(MONITOR)
        if fraction is not None and fraction * self._stream_m_s < min(
            self._needed_m_s, self._stream_m_s
        ) * (1.0 - SPEED_NOISE):
            followed_mm_s, needed_mm_s = 1e3 * fraction * self._stream_m_s, 1e3 * self._needed_m_s
            text = (
                f"the controller's monitor speed is {100.0 * fraction:g} %: set points are "
                f"followed at {followed_mm_s:.1f} mm/s, force.speed_max_m_s requires "
                f"{needed_mm_s:g} mm/s"
            )
            return tripped("monitor_speed", text, value=fraction)
        return self._late(numbers.get(STREAMED), self._allowed_s)

    def update(self, inputs: Inputs) -> Trip | None:
        """Return why running force feedback must end; called once per snapshot."""
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
            f"the controller executes a set point {took_s * 1e3:.0f} ms after it was sent, in the "
            f"median; robot.delay_s plus lag_s is {self._allowed_s * 1e3:.0f} ms"
        )
        return tripped("delay", text, value=took_s, limit=limit_s, unit="s")


def _numbers(inputs: Inputs) -> dict[str, float]:
    reading = inputs.health.get("robot")
    health = None if reading is None else reading.fresh
    return {} if health is None else health.numbers

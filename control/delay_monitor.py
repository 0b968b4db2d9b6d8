"""Monitor of the loop delay: its estimate during a session, and the gain share that follows. Pure.

A loop is tuned for the modelled delay tau (`Plant.tau_s`), with Ki = c / (k tau). A longer delay
makes the same gains ring. The excess d over the model follows from the motion of the flange:

    x_model(t) - x_measured(t) = d v_model(t) - b x_model(t) + offset

x_model is the released command after dead time and servo lag (`delay_model.py`), run with the
present estimate. Weighted least squares with forgetting, over all three axes, gives d. The term b x
is the arm's own compliance: in contact its deflection is proportional to the travel, and would
pass for delay. The fit counts only with enough motion: a standard deviation of d below SURE_S, or
below SURE_SHARE of d, as a model that is far off leaves larger residuals.
At rest the last estimate stays, and the round trip of the link is a second source: its rise since
the start of the session. The larger one counts.

Beyond a tolerance the gain share is tau / (tau + d): falling within some samples, rising slowly.
An oscillation halves the share until the session ends; one that persists at LEAST_LOWERED stops it.
"""

from dataclasses import dataclass, field
from math import exp, sqrt

from common.config.cell import CellConfig
from common.config.plant import Delays
from common.motion.frames import Vector, plus
from control.delay_model import LoopDelayModel
from control.estimates import Moments
from control.gains import SAME_GAIN
from forcemesh.messages import Vec3

MEMORY_TAUS, MEMORY_PERIODS, MEMORY_LEAST_S = 4.0, 20.0, 0.2  # forgetting of the fit
NOISE_M = 1e-5  # standard deviation of a reported position
SURE_S, SURE_SHARE = 0.003, 0.15  # largest standard deviation of an accepted excess
FEW_SAMPLES, FITTED = 8.0, 3.0  # least weight of the samples; degrees of freedom of the fit
FOLLOW_SHARE = 0.5  # change of the estimate per time: the model's dead time never runs backwards
LONGEST_EXCESS_TAUS = 10.0
LEAST_MODEL_SHARE = 0.5  # of the dead time that is modelled at least
TOLERANCE_SHARE, TOLERANCE_S = 0.4, 0.005  # of tau; the larger one
LINK_S = 0.3  # time constant of the link's round trip
FALL_S, RISE_S = 0.03, 1.0  # time constants of the gain share
AT_GOAL = 1e-3  # a share this near its goal is there
HALVED, LEAST_LOWERED = 0.5, 0.25  # two halvings


@dataclass(frozen=True, slots=True)
class DelayMonitorSettings:
    """Constants of the monitor for one cell."""

    tau_s: float  # modelled delay of the whole loop
    arm: Delays  # from the released command to the reported pose
    memory_s: float
    tolerance_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "DelayMonitorSettings":
        """Return the constants of a cell."""
        plant = cell.plant
        memory_s = plant.memory_s(MEMORY_TAUS, MEMORY_PERIODS, MEMORY_LEAST_S)
        tolerance_s = max(TOLERANCE_SHARE * plant.tau_s, TOLERANCE_S)
        return cls(plant.tau_s, plant.arm, memory_s, tolerance_s)

    def share_for(self, excess_s: float) -> float:
        """Return the share of the gains that a loop with this excess delay [s] bears."""
        return self.tau_s / (self.tau_s + excess_s) if excess_s > self.tolerance_s else 1.0


class ExcessFit:
    """Least squares of the excess delay over three axes, with forgetting."""

    def __init__(self) -> None:
        """Start without samples."""
        self._axes = [(Moments(), Moments(), Moments()) for _ in range(3)]

    def add(
        self, travel_m: Vector, speed_m_s: Vector, behind_m: Vector, forgetting: float
    ) -> tuple[float, float] | None:
        """Add a sample; return excess and its standard deviation [s], None if undetermined.

        Args:
            travel_m: Modelled position. Shape (3,), as the others.
            speed_m_s: Its speed.
            behind_m: By how much the measured position is behind the undelayed model.
            forgetting: Weight of the samples so far.
        """
        xx = xv = vv = xy = vy = yy = weight = 0.0
        rows = zip(self._axes, travel_m, speed_m_s, behind_m, strict=True)
        for (of_travel, of_behind, of_speed), x, v, y in rows:
            a, b, c = of_travel.add(x, v, forgetting)
            _, d, e = of_behind.add(x, y, forgetting)
            _, f, _ = of_speed.add(v, y, forgetting)
            xx, xv, vv, xy, yy, vy = xx + a, xv + b, vv + c, xy + d, yy + e, vy + f
            weight = of_travel.weight
        square = xx * vv - xv * xv
        if weight < FEW_SAMPLES or not square > 0.0:
            return None
        excess_s, bend = (vy * xx - xy * xv) / square, (xy * vv - vy * xv) / square
        residual = max(yy - excess_s * vy - bend * xy, 0.0)
        variance = residual / (weight - FITTED) + NOISE_M**2
        return excess_s, sqrt(variance * xx / square)


@dataclass(slots=True)
class DelayMonitor:
    """Estimates of one session and its gain share; advanced in place."""

    fit: ExcessFit = field(default_factory=ExcessFit)
    model: LoopDelayModel | None = None  # of the flange's position; None before the first command
    origin_m: Vec3 = (0.0, 0.0, 0.0)  # of the travel: the first command
    excess_s: float = 0.0  # from motion
    is_measured: bool = False  # there was enough motion
    settling_s: float = 0.0  # until the model has forgotten a gap in the samples
    unreported_s: float = 0.0  # since the last reported pose
    trip_s: float | None = None  # low-passed round trip of the link
    least_trip_s: float = 0.0  # the least of it
    lowered: float = 1.0  # by oscillation
    share: float = 1.0  # of the gains, ramped

    @property
    def excess_now_s(self) -> float:
        """Delay beyond the model by the worse of both sources [s], not negative."""
        return max(self.excess_s, (self.trip_s or 0.0) - self.least_trip_s)

    def follow(
        self,
        command_m: Vec3,
        measured_m: Vec3 | None,
        *,
        dt_s: float,
        is_late: bool,
        settings: DelayMonitorSettings,
    ) -> None:
        """Update the estimate from motion by one more sample.

        Args:
            command_m: Released position of the flange, in base.
            measured_m: Reported one; None without a new report.
            dt_s: Time since the last sample.
            is_late: Inputs are late, so the model's times are not those of the arm for a while.
            settings: Constants of the cell.
        """
        if self.model is None:
            self.model, self.origin_m = LoopDelayModel((0.0, 0.0, 0.0)), command_m
        model, dead_s = self.model, settings.arm.delay_s
        running = Delays(dead_s + self.excess_s, settings.arm.lag_s, 0.0)
        model.follow(plus(command_m, self.origin_m, -1.0), dt_s, running)
        self.unreported_s += dt_s
        self.settling_s = max(0.0, self.settling_s - dt_s)
        if is_late:
            self.settling_s = settings.memory_s
        if measured_m is None or self.settling_s > 0.0:
            return
        travel_m = plus(measured_m, self.origin_m, -1.0)
        behind_m = plus(plus(model.arm, travel_m, -1.0), model.speed, self.excess_s)
        forgetting = exp(-self.unreported_s / settings.memory_s)
        fitted = self.fit.add(model.arm, model.speed, behind_m, forgetting)
        most_s, self.unreported_s = FOLLOW_SHARE * self.unreported_s, 0.0
        if fitted is not None and fitted[1] < max(SURE_S, SURE_SHARE * abs(fitted[0])):
            change_s = min(max(fitted[0] - self.excess_s, -most_s), most_s)
            longest_s, least_s = LONGEST_EXCESS_TAUS * settings.tau_s, -LEAST_MODEL_SHARE * dead_s
            self.excess_s = min(max(self.excess_s + change_s, least_s), longest_s)
            self.is_measured = True

    def follow_link(self, trip_s: float | None, dt_s: float) -> None:
        """Update the rise of the link's round trip [s]; None: unknown, which says nothing."""
        if trip_s is None:
            return
        if self.trip_s is None:
            self.trip_s = self.least_trip_s = trip_s
        self.trip_s += min(1.0, dt_s / LINK_S) * (trip_s - self.trip_s)
        self.least_trip_s = min(self.least_trip_s, self.trip_s)

    def ramp(self, dt_s: float, settings: DelayMonitorSettings) -> None:
        """Move the gain share towards the one that the delay permits."""
        goal = self.lowered * settings.share_for(self.excess_now_s)
        time_s = FALL_S if goal < self.share else RISE_S
        self.share += min(1.0, dt_s / time_s) * (goal - self.share)
        if abs(goal - self.share) < AT_GOAL:
            self.share = goal

    def numbers(self, settings: DelayMonitorSettings) -> dict[str, float]:
        """Return the numbers for the health message; nothing measured, nothing said."""
        numbers = {"loop_delay_model_s": settings.tau_s, "gain_fraction": self.share}
        if self.is_measured:
            numbers["loop_delay_s"] = settings.tau_s + self.excess_s
        return numbers

    def lower(self) -> bool:
        """Halve the gains after an oscillation; return False if they are at the least already."""
        if self.lowered <= LEAST_LOWERED:
            return False
        self.lowered *= HALVED
        return True


def share_to_send(sent: float, share: float) -> float:
    """Return the share for a controller's gains: small changes are not sent, full gains are."""
    return share if share == 1.0 or abs(share - sent) > SAME_GAIN * sent else sent

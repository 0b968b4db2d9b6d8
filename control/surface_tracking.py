"""Surface tracking: feed-forward of the surface's motion along the press axis. Pure.

It starts once the force has been near its set point. The surface position follows from the force,

    x_surface = x_filtered - F / k

with F the contact force without the tool's inertial force, which on a soft contact is the larger
part of an oscillation. If k is too high, part of the tool's own motion is taken for the surface's.

Its motion is observed by a critically damped alpha-beta filter with p = exp(-dt / T),
alpha = 1 - p^2, beta = (1 - p)^2. Its speed lags by 2 T while the surface accelerates; the
low-passed derivative of that speed compensates for the lag.
"""

from dataclasses import dataclass, field
from math import exp

NEAR_N = 2.0  # force error at which surface tracking starts
FADE_S = 0.05
DRIFT_TAUS, DRIFT_LEAST_S, DRIFT_NOISE_N = 0.7, 0.025, 0.2
STEADY_N, STEADY_UP_S, STEADY_DOWN_S = 3.0, 0.3, 0.01  # use of the surface's acceleration
TRIM_TAUS, TRIM_SHARE, TRIM_LEAST_M_S = 8.0, 0.25, 1e-4


@dataclass(slots=True)
class SurfaceMotion:
    """Position and motion of the surface; position None before the first sample."""

    position_m: float | None = None
    speed_m_s: float = 0.0
    accel_m_s2: float = 0.0
    lag_s: float = 0.0  # lag of the speed estimate

    def update(
        self, measured_m: float, dt_s: float, *, time_s: float, ahead_s: float, share: float
    ) -> tuple[float, float]:
        """Update the estimate; return travel [m] in a time to come and speed after it.

        Args:
            measured_m: Measured position.
            dt_s: Time since the last one.
            time_s: T.
            ahead_s: The time to come.
            share: Share of the acceleration that is used in it.
        """
        if self.position_m is None:
            self.position_m, self.lag_s = measured_m, 2.0 * time_s
            return 0.0, 0.0
        pole = exp(-dt_s / time_s)
        expected_m = self.position_m + self.speed_m_s * dt_s
        error_m = measured_m - expected_m
        gained_m_s = (1.0 - pole) ** 2 / dt_s * error_m
        self.accel_m_s2 = pole * self.accel_m_s2 + (1.0 - pole) * gained_m_s / dt_s
        self.position_m = expected_m + (1.0 - pole * pole) * error_m
        self.speed_m_s += gained_m_s
        accel_m_s2 = share * self.accel_m_s2
        travel_m = (self.speed_m_s + accel_m_s2 * (self.lag_s + 0.5 * ahead_s)) * ahead_s
        return travel_m, self.speed_m_s + accel_m_s2 * (self.lag_s + ahead_s)


@dataclass(slots=True)
class SurfaceTracking:
    """State of surface tracking; advanced in place."""

    near: bool = False  # near the set point since it changed or contact was lost: tracking
    drift: SurfaceMotion = field(default_factory=SurfaceMotion)
    share: float = 0.0  # of the drift that is fed forward
    steadiness: float = 0.0  # share of its acceleration that is used
    trim_m_s: float = 0.0  # integral correction of the model's remaining error
    setpoint_N: float = 0.0

    def update(
        self,
        *,
        force_N: float,
        setpoint_N: float,
        dt_s: float,
        k_N_m: float,
        may_begin: bool,
        in_contact: bool,
        filtered_travel_m: float,
        in_flight_m: float,
        inertial_N: float,
        Ki: float,
        tau_s: float,
    ) -> tuple[float, float]:
        """Update the state; return the surface's travel, and its speed to feed forward.

        The travel is that until this sample's command arrives [m]. A surface at rest is not
        tracked: travel and speed are weighted against noise.

        All quantities are those along the press axis.

        Args:
            force_N: Of the environment on the tool.
            setpoint_N: Of the tool on the environment.
            dt_s: Length of this period.
            k_N_m: Stiffness of the contact.
            may_begin: Whether k is identified, not only bounded.
            in_contact: Whether the tool touches the surface.
            filtered_travel_m: Commanded travel that the filtered force belongs to.
            in_flight_m: Commanded travel still in flight.
            inertial_N: Inertial force of the tool in the sensor's reading.
            Ki: Integral gain [m/(N s)].
            tau_s: The loop's delay.
        """
        drift, error_N = self.drift, force_N + setpoint_N
        is_near = max(abs(error_N), abs(k_N_m * in_flight_m)) < NEAR_N
        may_track = in_contact and setpoint_N == self.setpoint_N
        self.near = may_track and (self.near or (is_near and may_begin))
        self.setpoint_N = setpoint_N
        self.share += (self.near - self.share) * min(1.0, dt_s / FADE_S)
        if not self.near:
            self.drift, self.steadiness, self.trim_m_s = SurfaceMotion(), 0.0, 0.0
            return 0.0, 0.0
        is_steady = abs(error_N) < STEADY_N
        steadiness_s = STEADY_UP_S if is_steady else STEADY_DOWN_S
        self.steadiness += (is_steady - self.steadiness) * min(1.0, dt_s / steadiness_s)
        surface_m = filtered_travel_m + (force_N + inertial_N) / k_N_m
        time_s = max(DRIFT_TAUS * tau_s, DRIFT_LEAST_S, dt_s)
        travel_m, speed_m_s = drift.update(
            surface_m, dt_s, time_s=time_s, ahead_s=tau_s - dt_s, share=self.steadiness
        )
        most_m_s = TRIM_SHARE * self.share * abs(drift.speed_m_s) + TRIM_LEAST_M_S
        trim_m_s = self.trim_m_s + Ki * error_N / (TRIM_TAUS * tau_s) * self.share * dt_s
        self.trim_m_s = min(max(trim_m_s, -most_m_s), most_m_s)
        root_N = k_N_m * tau_s * drift.speed_m_s
        height_N2 = root_N * root_N
        used_share = self.share * height_N2 / (height_N2 + DRIFT_NOISE_N**2)
        return used_share * travel_m, used_share * speed_m_s + self.trim_m_s

"""Lag, bandwidth and stored energy of the simulated arm, computed from its settings and state."""

import numpy as np

from sim.robot.plate import SprungPlate
from sim.robot.settings import TICK_S, SimSettings

# -3 dB of a critically damped servo: sqrt(sqrt(2) - 1) times its natural frequency 2 / lag.
_SERVO_BANDWIDTH = 2.0 * (2.0**0.5 - 1.0) ** 0.5


def motion_lag_s(settings: SimSettings) -> float:
    """Return the area lag from command to flange without the dead time [s].

    The integral of 1 - y/y_end after a step: half the smoothing window plus kv/kp of the servo.
    """
    return (settings.smoothing_ticks - 1) / 2 * TICK_S + settings.servo_lag_s


def bandwidth_rad_s(settings: SimSettings) -> float:
    """Return the -3 dB frequency of the flange's motion, smoothing included [rad/s].

    |H| = |sin(w T/2) / (w T/2)| / (1 + (w lag/2)^2) = 1/sqrt(2), solved by bisection.
    """
    window_s, lag_s = settings.smoothing_ticks * TICK_S, settings.servo_lag_s
    low, high = 0.0, _SERVO_BANDWIDTH / lag_s  # the servo alone bounds it
    for _ in range(60):
        w = 0.5 * (low + high)
        gain = np.sinc(w * window_s / 2 / np.pi) / (1.0 + (w * lag_s / 2) ** 2)
        low, high = (w, high) if gain > 0.5**0.5 else (low, w)
    return 0.5 * (low + high)


def energy_J(plate: SprungPlate) -> float:
    """Return the elastic energy of the plate's springs [J]."""
    lengths2 = plate.travel_m**2 + plate.shear_m[0] ** 2 + plate.shear_m[1] ** 2
    angles2 = plate.slope[0] ** 2 + plate.slope[1] ** 2 + plate.twist_rad**2
    return 0.5 * (plate.stiffness_N_m * lengths2 + plate.tilt_stiffness_Nm_rad * angles2)

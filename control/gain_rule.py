"""Gain rule: integral gains from the stiffest contact and the loop delay. Pure.

For an integrator with dead time tau, v = Ki (F - F_set), the loop gain k Ki tau = 0.45 settles from
30 N to 1 N in four to five tau with at most 2 % overshoot. Overshoot begins at 1/e (critical
damping), the stability limit is pi/2; with proportional action only it is k Kp = 1. Independently
of the stiffness, the inertia in front of the sensor turns the force feedback positive above the
robot's bandwidth: Ki < 1 / (m w_b), halved here.
"""

from dataclasses import dataclass
from math import pi

from common.config.cell import CellConfig
from forcemesh.messages import Gains, Preset

LOOP_GAIN = 0.45  # k Ki tau
LOOP_GAINS: dict[Preset, float] = {"gentle": 0.2, "normal": LOOP_GAIN, "stiff": 0.6}
INERTIA_MARGIN = 0.5  # of 1 / (m w_b)


@dataclass(frozen=True, slots=True)
class Tuning:
    """Gains of the gain rule for one cell."""

    tau_s: float  # all delay and lag in the loop
    force_i_m_per_Ns: float
    torque_i_rad_per_Nms: float

    @property
    def gains(self) -> Gains:
        """Gains of all axes."""
        return equal_gains(self.force_i_m_per_Ns, self.torque_i_rad_per_Nms)


def equal_gains(force: float, torque: float) -> Gains:
    """Return the same integral gains for all axes [m/(N s)], [rad/(N m s)].

    There is no proportional action, which would only compensate a known lag.
    """
    return Gains(force_i_m_per_Ns=(force,) * 3, torque_i_rad_per_Nms=(torque,) * 3)


def rule_gain(
    stiffness: float,
    inertia: float,
    *,
    tau_s: float,
    bandwidth_rad_s: float,
    loop_gain: float = LOOP_GAIN,
) -> float:
    """Return the gain of the rule for one stiffness and inertia, of force or of torque."""
    margin = INERTIA_MARGIN * min(1.0, loop_gain / LOOP_GAIN)
    return min(loop_gain / (stiffness * tau_s), margin / (inertia * bandwidth_rad_s))


def tune(cell: CellConfig, preset: Preset = "normal") -> Tuning:
    """Apply the gain rule to a cell.

    `gentle` never overshoots and takes three times as long. `stiff` reduces the error on a moving
    surface by a quarter and overshoots by 5 to 10 %, as far as the inertia cap permits.
    """
    plant = cell.plant
    force, torque = (
        rule_gain(
            *of_contact,
            tau_s=plant.tau_s,
            bandwidth_rad_s=plant.bandwidth_rad_s,
            loop_gain=LOOP_GAINS[preset],
        )
        for of_contact in (
            (plant.stiffness_N_m, plant.inertia_kg),
            (plant.tilt_stiffness_Nm_rad, plant.inertia_kg_m2),
        )
    )
    return Tuning(plant.tau_s, force, torque)


def instability(cell: CellConfig, gains: Gains) -> str:
    """Return the gains that make the loop unstable at the stiffest contact, empty if none does.

    The actual contact may be softer: a request may accept them.
    """
    plant = cell.plant
    tau_s, stiffness, tilt = plant.tau_s, plant.stiffness_N_m, plant.tilt_stiffness_Nm_rad
    bandwidth = plant.bandwidth_rad_s
    ends = {
        "force_p_m_per_N": 1.0 / stiffness,
        "force_i_m_per_Ns": min(pi / 2 / (stiffness * tau_s), 1 / (plant.inertia_kg * bandwidth)),
        "torque_p_rad_per_Nm": 1.0 / tilt,
        "torque_i_rad_per_Nms": min(
            pi / 2 / (tilt * tau_s), 1.0 / (plant.inertia_kg_m2 * bandwidth)
        ),
    }
    violations = [
        f"{name} above {end:.2g}" for name, end in ends.items() if max(getattr(gains, name)) > end
    ]
    if not violations:
        return ""
    conditions = f"contact.stiffness_N_m {stiffness:g} and a delay of {1e3 * tau_s:.0f} ms"
    return f"unstable at {conditions}: {', '.join(violations)}"

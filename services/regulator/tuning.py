"""The gain rule: integral gains from the stiffest contact and the loop's delay. Pure.

For an integrator behind a dead time, v = Ki (F - F_set), the loop k Ki tau = 0.45 settles from
30 N to 1 N in four to five tau with at most 2 % overshoot; 1/e is where overshoot begins and
pi/2 where stability ends. Independently of the stiffness, the inertia in front of the sensor
makes the force feedback positive above the robot's bandwidth: Ki < 1 / (m w_b), halved here.
"""

from dataclasses import dataclass

from common.cell import Cell
from common.messages import Gains

LOOP_GAIN = 0.45  # k Ki tau
INERTIA_MARGIN = 0.5  # of 1 / (m w_b)


@dataclass(frozen=True, slots=True)
class Tuning:
    """What the gain rule made of a cell."""

    tau_s: float  # all delay and lag in the loop
    force_i_m_per_Ns: float
    torque_i_rad_per_Nms: float

    @property
    def gains(self) -> Gains:
        """The same for all axes; the proportional part is zero (it only fights known lag)."""
        force, torque = self.force_i_m_per_Ns, self.torque_i_rad_per_Nms
        return Gains(
            force_i_m_per_Ns=(force, force, force),
            torque_i_rad_per_Nms=(torque, torque, torque),
        )


def tune(cell: Cell) -> Tuning:
    """Apply the gain rule to a cell."""
    tau_s = loop_delay_s(cell)
    bandwidth = cell.robot.bandwidth_rad_s
    contact = cell.contact
    force = min(
        LOOP_GAIN / (contact.stiffness_N_m * tau_s),
        INERTIA_MARGIN / (contact.inertia_kg * bandwidth),
    )
    torque = min(
        LOOP_GAIN / (contact.tilt_stiffness_Nm_rad * tau_s),
        INERTIA_MARGIN / (contact.inertia_kg_m2 * bandwidth),
    )
    return Tuning(tau_s, force, torque)


def loop_delay_s(cell: Cell) -> float:
    """Return tau [s], all that lies between a change of force and the arm's answer to it."""
    return cell.loop_delay_s

"""The control laws that are compared in the scenes, and the start of a scene."""

from collections.abc import Callable

from bench.force.pilots import Guided, Ours, Plain
from bench.force.rig import Rig, Trace, World

HOLD_N = 10.0

Pilot = Ours | Plain | Guided
Make = Callable[[Rig], Pilot]
Measures = dict[str, float]


def adaptive(rig: Rig) -> Pilot:
    """Our law."""
    return Ours(rig.cell, rig.T_base_tcp, rig.arm.T_base_tcp)


def plain(rig: Rig) -> Pilot:
    """The PI law with the gain rule for the stiffest contact."""
    return Plain(rig.cell, rig.T_base_tcp)


def tuned_plain(rig: Rig) -> Pilot:
    """The PI law with the gain rule for this scene's known stiffness."""
    k, tau_s = rig.arm.settings.stiffness_N_m, rig.cell.loop_delay_s
    inertia = 0.5 / (rig.cell.contact.inertia_kg * rig.cell.robot.bandwidth_rad_s)
    return Plain(rig.cell, rig.T_base_tcp, min(0.45 / (k * tau_s), inertia))


def guided(rig: Rig) -> Pilot:
    """Our law for hand guiding."""
    return Guided(rig.cell, rig.T_base_tcp, rig.arm.T_base_tcp)


def holding(world: World, make: Make, setpoint_N: float = HOLD_N) -> tuple[Rig, Pilot, Trace]:
    """Return a rig at its set point after a light contact, and the trace."""
    rig = Rig(world.cell())
    rig.press(3.0)
    pilot = make(rig)
    pilot.setpoint_N = setpoint_N
    trace = rig.run(pilot, 1.5 if make is not plain else 4.0)
    return rig, pilot, trace

"""The control laws that are compared in the scenes, and the start of a scene."""

from collections.abc import Callable

from bench.force.pilots import AdaptiveLawRunner, GuidingLawRunner, PlainLawRunner
from bench.force.rig import ForceRig, SceneSettings, Trace

HOLD_N = 10.0

Pilot = AdaptiveLawRunner | PlainLawRunner | GuidingLawRunner
Make = Callable[[ForceRig], Pilot]
Measures = dict[str, float]


def adaptive(rig: ForceRig) -> Pilot:
    """Our law."""
    return AdaptiveLawRunner(rig.cell, rig.T_base_tcp, rig.arm.T_base_tcp)


def plain(rig: ForceRig) -> Pilot:
    """The PI law with the gain rule for the stiffest contact."""
    return PlainLawRunner(rig.cell, rig.T_base_tcp)


def tuned_plain(rig: ForceRig) -> Pilot:
    """The PI law with the gain rule for this scene's known stiffness."""
    k, tau_s = rig.arm.settings.stiffness_N_m, rig.cell.loop_delay_s
    inertia = 0.5 / (rig.cell.contact.inertia_kg * rig.cell.robot.bandwidth_rad_s)
    return PlainLawRunner(rig.cell, rig.T_base_tcp, min(0.45 / (k * tau_s), inertia))


def guided(rig: ForceRig) -> Pilot:
    """Our law for hand guiding."""
    return GuidingLawRunner(rig.cell, rig.T_base_tcp, rig.arm.T_base_tcp)


def holding(
    world: SceneSettings, make: Make, setpoint_N: float = HOLD_N
) -> tuple[ForceRig, Pilot, Trace]:
    """Return a rig at its set point after a light contact, and the trace."""
    rig = ForceRig(world.cell())
    rig.press(3.0)
    pilot = make(rig)
    pilot.setpoint_N = setpoint_N
    trace = rig.run(pilot, 1.5 if make is not plain else 4.0)
    return rig, pilot, trace

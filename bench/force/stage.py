"""The control laws that are compared in the scenes, and the start of a scene."""

from collections.abc import Callable

from bench.force.pilots import LawRunner
from bench.force.rig import ForceRig, SceneSettings, Trace

HOLD_N = 10.0

Make = Callable[[ForceRig], LawRunner]
Measures = dict[str, float]


def adaptive(rig: ForceRig) -> LawRunner:
    """Our law."""
    return LawRunner("adaptive", rig.cell, rig.T_base_tcp, rig.arm.T_base_tcp)


def plain(rig: ForceRig) -> LawRunner:
    """The PI law with the gain rule for the stiffest contact."""
    return LawRunner("plain", rig.cell, rig.T_base_tcp)


def tuned_plain(rig: ForceRig) -> LawRunner:
    """The PI law with the gain rule for this scene's known stiffness."""
    k, tau_s = rig.arm.settings.stiffness_N_m, rig.cell.loop_delay_s
    inertia = 0.5 / (rig.cell.contact.inertia_kg * rig.cell.robot.bandwidth_rad_s)
    gain = min(0.45 / (k * tau_s), inertia)
    return LawRunner("plain", rig.cell, rig.T_base_tcp, gain_m_per_Ns=gain)


def guided(rig: ForceRig) -> LawRunner:
    """Our law for hand guiding."""
    return LawRunner("admittance", rig.cell, rig.T_base_tcp, rig.arm.T_base_tcp)


def holding(
    world: SceneSettings, make: Make, setpoint_N: float = HOLD_N
) -> tuple[ForceRig, LawRunner, Trace]:
    """Return a rig at its set point after a light contact, and the trace."""
    rig = ForceRig(world.cell())
    rig.press(3.0)
    pilot = make(rig)
    pilot.setpoint_N = setpoint_N
    trace = rig.run(pilot, 1.5 if make is not plain else 4.0)
    return rig, pilot, trace

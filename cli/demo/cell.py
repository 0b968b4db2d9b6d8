"""Cell of the demo: a cell file with the requested plate and delay."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cli.demo.measures import Surface
from cli.demo.scenario import ScenarioPlan
from common.config.cell import CellConfig
from common.config.load import load_cell
from control.measured_range import segment_approach_m_s
from forcemesh.errors import ConfigError
from forcemesh.messages import Law
from sim.robot.scene import plate_at_rest
from sim.robot.settings import SimSettings

DEFAULT_TILT_DEG = {"position": 0.0, "orientation": 5.0, "both": 5.0}
DEFAULT_SETPOINT_N = {"position": 0.0, "orientation": 0.0, "both": 10.0}
LEAST_PRESS_N = 5.0
# Further delay of a controller that reaches the speed of a motion 0.2 s after its start: a segment
# planned for 30 ms takes 0.16 s, and the next one begins in its middle.
PESSIMISTIC_DELAY_S = 0.134
# Further delay of longer segments: the rest of the active one, the next one, and the sampling of
# the loop. With 2.5 a plate may be overshot by 6.3 %.
SEGMENTS_OF_DELAY = 3.0


@dataclass(frozen=True, slots=True)
class DemoOverrides:
    """Overrides of the cell file by the demo; None keeps the value of the file."""

    tilt_deg: float = 0.0
    stiffness_N_m: float | None = None
    delay_s: float | None = None
    seed: int | None = None
    as_step_s: float | None = None
    pessimistic: bool = False
    least_segment_s: float | None = None  # of the controller and of its program's motions
    motions_ahead: int | None = None
    law: Law | None = None


def demo_cell(path: Path, trial: DemoOverrides) -> CellConfig:
    """Load a cell file with the demo's options; the gain rule uses the same values.

    The plate rests on springs at its corners, so its tilt stiffness scales with its stiffness.

    Raises:
        ConfigError: The cell file or an option is invalid, or the cell is not simulated.
    """
    plate_of(load_cell(path))  # first: the overrides would create a section `sim`
    overrides: dict[str, object] = {"sim.tilt_deg": trial.tilt_deg}
    if trial.law is not None:
        overrides["force.law"] = trial.law
    if trial.seed is not None:
        overrides["sim.seed"] = trial.seed
    controller = (trial.as_step_s, trial.least_segment_s, trial.motions_ahead)
    if trial.pessimistic or any(value is not None for value in controller):
        overrides |= _controller_overrides(load_cell(path), trial)
    if trial.delay_s is not None:
        plain = load_cell(path, overrides)
        program_delay_s = 0.0 if plain.sim is None else plain.robot.delay_s - plain.sim.delay_s
        overrides["sim.delay_s"] = trial.delay_s
        overrides["robot.delay_s"] = trial.delay_s + program_delay_s  # delay of a program is kept
    if trial.stiffness_N_m is not None:
        overrides["sim.stiffness_N_m"] = trial.stiffness_N_m
        overrides["contact.stiffness_N_m"] = trial.stiffness_N_m
        stiffer = plate_of(load_cell(path, overrides))
        overrides["contact.tilt_stiffness_Nm_rad"] = stiffer.plate_tilt_stiffness_Nm_rad
    cell = load_cell(path, overrides)
    fastest_m_s = min(cell.plant.approach_limit_m_s, segment_approach_m_s(cell))
    if cell.force.approach_m_s > fastest_m_s:  # the file's value is for its own plate
        cell = load_cell(path, overrides | {"force.approach_m_s": fastest_m_s})
    plate_of(cell)
    return cell


def _controller_overrides(plain: CellConfig, trial: DemoOverrides) -> dict[str, object]:
    """Return the overrides for another speed of the emulated controller.

    The delay of its program and the rate of its reports scale with the step. A pessimistic one
    accelerates by time: its segments take longer than they are planned for. Longer segments are a
    longer delay.
    """
    if plain.sim is None or plain.roles.robot != "gateway":
        text = "--as-step-ms and --pessimistic need a cell with an emulated controller"
        raise ConfigError(plain.cell, [f"{text}, such as cells/demo-tcp.yaml"])
    ratio = 1.0 if trial.as_step_s is None else trial.as_step_s / plain.sim.as_step_s
    slower_s = PESSIMISTIC_DELAY_S if trial.pessimistic else 0.0
    if trial.least_segment_s is not None and plain.gateway is not None:
        # Shorter ones than in the file are limited by the program's own time.
        longer_s = max(trial.least_segment_s - plain.gateway.least_segment_s, 0.0)
        slower_s += SEGMENTS_OF_DELAY * longer_s
    overrides: dict[str, object] = {
        "sim.as_step_s": plain.sim.as_step_s * ratio,
        "sim.as_pessimistic": trial.pessimistic or plain.sim.as_pessimistic,
        "robot.delay_s": plain.robot.delay_s * ratio + slower_s,
        "rates.robot_hz": plain.rates.robot_hz / ratio,
    }
    if trial.least_segment_s is not None:
        overrides["sim.as_least_segment_s"] = trial.least_segment_s
        overrides["gateway.least_segment_s"] = trial.least_segment_s
    if trial.motions_ahead is not None:
        overrides["sim.as_motions_ahead"] = trial.motions_ahead
    return overrides


def plate_of(cell: CellConfig) -> SimSettings:
    """Return the simulated cell's settings, checked before any process is started."""
    if cell.sim is None:
        text = "the demo needs a cell with a section `sim`: it arms and presses without asking"
        raise ConfigError(cell.cell, [text])
    if cell.sim.surface != "plane":
        text = f"the demo measures on a plane plate: sim.surface is {cell.sim.surface}, set plane"
        raise ConfigError(cell.cell, [text])
    return SimSettings.of(cell)


def check_plan(cell: CellConfig, plan: ScenarioPlan) -> None:
    """Raise ConfigError for a plan that the cell cannot run, before any process is started."""
    mistakes = []
    highest_N = min(cell.force.setpoint_max_N, cell.limits.force_N)
    if plan.host not in cell.robot.hosts:
        mistakes.append(
            f"--host {plan.host}: it needs a cell with a controller that runs force feedback; "
            f"cell {cell.cell} offers {', '.join(cell.robot.hosts)}"
        )
    if not LEAST_PRESS_N <= plan.press_N <= highest_N:
        mistakes.append(
            f"--force {plan.press_N:g}: must be within {LEAST_PRESS_N:g} .. {highest_N:g} N"
        )
    if not 0.0 <= plan.setpoint_N <= highest_N:
        mistakes.append(f"--setpoint {plan.setpoint_N:g}: must be within 0 .. {highest_N:g} N")
    if plan.mode == "both" and plan.setpoint_N < LEAST_PRESS_N:
        mistakes.append(
            f"--setpoint {plan.setpoint_N:g}: a face aligns only while it is pressed, "
            f"mode both needs at least {LEAST_PRESS_N:g} N"
        )
    if plan.mode == "orientation" and plan.setpoint_N > 0.0:
        mistakes.append(
            f"--setpoint {plan.setpoint_N:g}: mode orientation controls the torque only and "
            "holds no force: choose position or both"
        )
    if mistakes:
        raise ConfigError("demo", mistakes)


def surface_of(cell: CellConfig) -> Surface:
    """Return the plate of a simulated cell, at which contact begins."""
    settings = plate_of(cell)
    plate = plate_at_rest(settings)
    return Surface(
        point_m=np.asarray(plate.point_m),
        normal=np.asarray(plate.normal),
        disc_radius_m=settings.disc_radius_m,
        stiffness_N_m=settings.stiffness_N_m,
        T_flange_tcp=cell.tool.T_flange_tcp.pose,
    )

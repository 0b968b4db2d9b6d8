"""Force feedback in the emulated controller, whose gains the PC adapts by command 6.

The cell of `cells/demo-tcp.yaml` in lock step on the virtual clock: gateway, TCP, the shipped AS
program. The configured stiffest contact is 1e5 N/m; the plate may be softer. The step time of
the emulated controller sets its loop rate, which is read from its own counter.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

from bench.over_tcp import CELL, in_lock_step
from cli.demo.cell import DemoOverrides, demo_cell, surface_of
from cli.demo.measures import measure
from cli.demo.scenario import ScenarioError, ScenarioPlan
from common.config.cell import CellConfig
from tuning.gain_rule import tune

FASTEST_STEP_S = 0.0001  # with longer ones the delay is beyond the range of the adaptive law
STEPS_S = (FASTEST_STEP_S, 0.0002, 0.0004)  # about 40, 20 and 8 iterations of the loop per second
STIFFNESSES_N_M = (5e3, 2e4, 1e5)
STIFFEST_N_M = 1e5
STAYS_S = 2.0


@dataclass(frozen=True, slots=True)
class Case:
    """One release with the loop in the controller."""

    as_step_s: float
    stiffness_N_m: float

    def cell(self) -> CellConfig:
        """Return a cell configured for the stiffest contact, not for this one."""
        trial = DemoOverrides(stiffness_N_m=STIFFEST_N_M, as_step_s=self.as_step_s, law="adaptive")
        cell = demo_cell(CELL, trial)
        if cell.sim is None:
            raise ValueError("the benchmark needs a simulated cell")
        plate = cell.sim.model_copy(update={"stiffness_N_m": self.stiffness_N_m})
        return cell.model_copy(update={"sim": plate})


CASES = tuple(Case(step_s, k) for step_s, k in product(STEPS_S, STIFFNESSES_N_M))


def row(case: Case) -> dict[str, Any]:
    """Return the measures of a release from 30 N at first contact."""
    cell = case.cell()
    plan = ScenarioPlan(mode="position", host="controller", setpoint_N=0.0, settled_for_s=STAYS_S)
    found: dict[str, Any] = {"as_step_s": case.as_step_s, "stiffness_N_m": case.stiffness_N_m}
    try:
        result = measure(in_lock_step(cell, plan), plan, surface_of(cell), tune(cell).tau_s)
    except ScenarioError as error:
        return found | {"stopped": str(error)}
    return found | {
        "tau_s": result.tau_s,
        "first_s": result.settling_s,
        "overshoot_pct": result.overshoot_pct,
        "loop_hz": result.robot_numbers.get("program_loop_hz"),
    }

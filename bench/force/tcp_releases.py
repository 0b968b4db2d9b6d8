"""Releases over TCP from a contact of unknown stiffness, by either law on either loop host.

The cell of `cells/demo-tcp.yaml` in lock step on the virtual clock: gateway, TCP, the shipped AS
program. The configured stiffest contact is 1e5 N/m; the plate may be softer. The step time of
the emulated controller sets its delay and its loop rate, which is read from its own counter.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any, get_args

from bench.over_tcp import CELL, in_lock_step
from cli.demo.cell import DemoOverrides, demo_cell, surface_of
from cli.demo.measures import measure
from cli.demo.scenario import ScenarioError, ScenarioPlan
from common.config.cell import CellConfig
from forcemesh.messages import Host, Law
from tuning.gain_rule import tune

STEPS_S = (0.000125, 0.0002)  # of the cell file, and of a slower controller
STIFFNESSES_N_M = (5e3, 2e4, 1e5)
STIFFEST_N_M = 1e5
LAWS: tuple[Law, ...] = ("adaptive", "plain")
STAYS_S = 2.0


@dataclass(frozen=True, slots=True)
class TcpRelease:
    """Step time, loop host and contact of one row."""

    as_step_s: float
    host: Host
    stiffness_N_m: float

    def cell(self, law: Law) -> CellConfig:
        """Return a cell configured for the stiffest contact, not for this one."""
        trial = DemoOverrides(stiffness_N_m=STIFFEST_N_M, as_step_s=self.as_step_s, law=law)
        cell = demo_cell(CELL, trial)
        if cell.sim is None:
            raise ValueError("the benchmark needs a simulated cell")
        plate = cell.sim.model_copy(update={"stiffness_N_m": self.stiffness_N_m})
        return cell.model_copy(update={"sim": plate})


CASES = tuple(TcpRelease(*case) for case in product(STEPS_S, get_args(Host), STIFFNESSES_N_M))


def row(case: TcpRelease) -> dict[str, Any]:
    """Return the measures of a release from 30 N at first contact, with each law."""
    found: dict[str, Any] = {
        "as_step_s": case.as_step_s,
        "host": case.host,
        "stiffness_N_m": case.stiffness_N_m,
    }
    for law in LAWS:
        found |= {f"{law}_{name}": value for name, value in _release(case, law).items()}
    return found


def _release(case: TcpRelease, law: Law) -> dict[str, Any]:
    """Return the measures with one law, or why the run has stopped."""
    cell = case.cell(law)
    plan = ScenarioPlan(mode="position", host=case.host, setpoint_N=0.0, settled_for_s=STAYS_S)
    try:
        result = measure(in_lock_step(cell, plan), plan, surface_of(cell), tune(cell).tau_s)
    except ScenarioError as error:
        return {"stopped": str(error)}
    return {
        "tau_s": result.tau_s,
        "first_s": result.settling_s,
        "overshoot_pct": result.overshoot_pct,
        "loop_hz": result.robot_numbers.get("program_loop_hz"),
    }

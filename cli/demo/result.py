"""Results of the demo: a table, and a picture of the scene."""

from pathlib import Path

import numpy as np
import pinocchio as pin
from rich.table import Table

from cli.demo.cell import plate_of, surface_of
from cli.demo.measures import Result
from cli.demo.scenario import (
    SETTLED_FORCE_N,
    SETTLED_TORQUE_NM,
    ScenarioPlan,
    ScenarioSample,
    Trace,
)
from common.config.cell import CellConfig

# fmt: off
LABELS = {  # of the numbers of robot/health in the table
    "framed_round_trip_p50_s": "command to acknowledgement, p50 [s]",
    "framed_round_trip_p99_s": "command to acknowledgement, p99 [s]",
    "taken_round_trip_p50_s": "command to execution, p50 [s]",
    "taken_round_trip_p99_s": "command to execution, p99 [s]",
    "streamed_round_trip_p50_s": "streamed command to execution, p50 [s]",
    "program_loop_hz": "program loop rate [1/s]",
    "sender_hz": "report rate [1/s]",
    "monitor_speed_fraction": "monitor speed [1]",
    "any_peer_may_connect": "any peer may connect",
}
# fmt: on


def table(result: Result, plan: ScenarioPlan, started: str) -> Table:
    """Return the result as a table; its title is the regulator's confirmation of the start."""
    goal = {
        "position": f"|F - {plan.setpoint_N:g} N| <= {SETTLED_FORCE_N:g} N",
        "orientation": f"|M| <= {SETTLED_TORQUE_NM:g} N m",
        "both": f"|F - {plan.setpoint_N:g} N| <= {SETTLED_FORCE_N:g} N, "
        f"|M| <= {SETTLED_TORQUE_NM:g} N m",
    }[plan.mode]
    rows = Table(title=f"force feedback: {started}", title_justify="left")
    rows.add_column("measure")
    rows.add_column("value", justify="right")
    rows.add_column("definition")
    settling = "not settled"
    if result.settling_s is not None:
        settling = f"{result.settling_s * 1e3:.0f} ms"
        settling += f" = {result.settling_s / result.tau_s:.1f} tau"
    rows.add_row("settled", "yes" if result.settled else "no", f"{goal} for 1 s")
    rows.add_row("settling time", settling, "from the start of force feedback")
    rows.add_row(
        "overshoot", f"{result.overshoot_pct:.1f} %", "lift-off, or force beyond the set point"
    )
    rows.add_row("peak force", f"{result.peak_force_N:.1f} N", "including pressing")
    rows.add_row("final force", f"{result.final_force_N:.2f} N", "mean of the last 0.5 s")
    rows.add_row(
        "final torque", f"{result.final_torque_Nm:.3f} N m", "mean of the last 0.5 s, about the TCP"
    )
    rows.add_row("misalignment", f"{result.misalignment_deg:.2f} deg", "tool axis to plate normal")
    rows.add_row("tau", f"{result.tau_s * 1e3:.1f} ms", "delay and lag used by the gain rule")
    for hop, (p50, p99) in result.hops_us.items():
        rows.add_row(hop, f"{p50:.0f} / {p99:.0f} us", "hop latency, p50 / p99")
    if result.chain_latency_us_p50 is not None and result.chain_latency_us_p99 is not None:
        p50, p99 = result.chain_latency_us_p50, result.chain_latency_us_p99
        rows.add_row("whole chain", f"{p50:.0f} / {p99:.0f} us", "sensor to robot, p50 / p99")
    for name, label in LABELS.items():  # the others are in --json
        if name in result.robot_numbers:
            rows.add_row(label, f"{result.robot_numbers[name]:.3g}", "from robot/health")
    return rows


def pictured(trace: Trace, plan: ScenarioPlan) -> ScenarioSample:
    """Return the sample to draw: the last one, or the last press where nothing is pressed after it.

    A tilted plate is drawn once the disc lies flat on it.
    """
    ends_pressing = plan.setpoint_N > 0.0 or plan.mode != "position"
    return trace.work[-1] if ends_pressing else trace.press[-1]


def picture(cell: CellConfig, sample: ScenarioSample, path: Path) -> None:
    """Write a picture of the scene at one sample. Raises RenderUnavailable without EGL."""
    from common.motion.kinematics import ArmKinematics
    from sim.robot.render import render_png

    settings = plate_of(cell)
    T_base_flange = pin.SE3(sample.T_base_flange)
    solution = ArmKinematics(settings.arm).solve(T_base_flange, settings.home_rad, jump_rad=np.pi)
    q = settings.home_rad if solution.q is None else solution.q
    contact_m = surface_of(cell).contact_m(sample)
    render_png(settings, path, q=q, force_N=sample.force_N, contact_m=contact_m)

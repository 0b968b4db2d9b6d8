"""`forcemesh tune`: measure delay and stiffness of a loop, recommend gains, report margins."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option, echo

from cli.context import NOT_WELL, OK, CellOption, JsonOption, exit_with_error, print_note
from cli.skills.force_session import force_session
from forcemesh.messages import Gains

if TYPE_CHECKING:
    from common.bus.configured_cell import ConfiguredCell
    from tuning.advice import Advice, MeasuredCell

SMALLEST_STEP_MM, LEAST_N = 0.5, 3.0

Step = Annotated[
    float, Option(min=SMALLEST_STEP_MM, max=10.0, help="Step size in free space [mm].")
]
Force = Annotated[float, Option(min=LEAST_N, help="Maximum press force [N].")]
NoPress = Annotated[bool, Option("--no-press", help="Steps only; stiffness from the cell file.")]
NoController = Annotated[
    bool, Option("--no-controller", help="Skip the controller's own force feedback.")
]
Apply = Annotated[bool, Option("--apply", help="Set the recommended gains, on a ramp.")]
ForHost = Annotated[
    str, Option("--for", metavar="HOST", help="With --apply: loop host, pc or controller.")
]
Write = Annotated[
    Path | None,
    Option(metavar="FILE", help="Write a file for the key `tuning` of the cell file."),
]
Report = Annotated[Path | None, Option("--out", metavar="FILE", help="Write a PNG figure.")]


def tune(
    *,
    step: Step = 3.0,
    force: Force = 12.0,
    no_press: NoPress = False,
    no_controller: NoController = False,
    apply: Apply = False,
    for_host: ForHost = "pc",
    write: Write = None,
    out: Report = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Measure the loop of a running cell and recommend gains with their margins.

    Start armed, in free space, with a surface in front of the tool: the arm makes small steps and
    presses gently until the results repeat, then returns. Ctrl-C holds the arm.
    """
    with force_session(cell) as (client, progress):
        from cli.tune import output
        from cli.tune.measure import TuningTrial, measure
        from tuning.advice import MeasuredCell, as_dict, cell_file_sections, refusal_reason

        hosts = client.config.robot.hosts
        _refuse_wrong_options(client, force, for_host, apply=apply)
        gains = client.force.gains()
        readings = measure(
            client,
            TuningTrial(step / 1e3, force),
            gain=_axial_gain(client, gains),
            with_press=not no_press,
            with_controller="controller" in hosts and not no_controller and not no_press,
            progress=progress,
        )
        config = client.config
        measured = MeasuredCell(readings.arm, readings.spring, readings.controller)
        advices = _advices(client, measured, gains)
        sections = cell_file_sections(config, measured, advices)
        if as_json:
            echo(json.dumps(as_dict(config, measured, advices, sections)))
        else:
            echo("\n".join(output.report_lines(config, measured, advices, sections)))
        if out is not None:
            title = f"{config.cell}: tau {1e3 * advices[0].tau_s:.1f} ms"
            output.save_figure(out, readings, advices, title)
            print_note(f"picture: {out}")
        if refusal := refusal_reason(config, measured, advices):
            exit_with_error(f"nothing is recommended, written or set: {refusal}", NOT_WELL)
        if write is not None:
            output.save_sections(write, sections)
            advice = f"set `tuning: {write}`, relative to its folder, in the cell file to use it"
            print_note(f"written to {write}; {advice}")
        if apply:
            _apply(client, advices, for_host)
        first = advices[0].force_now.margins
    raise Exit(OK if first.stable else NOT_WELL)


def _refuse_wrong_options(
    client: "ConfiguredCell", force_N: float, host: str, *, apply: bool
) -> None:
    config = client.config
    largest_N = min(config.force.setpoint_max_N, config.limits.force_N)
    if force_N > largest_N:
        exit_with_error(f"--force {force_N:g}: the cell allows at most {largest_N:g} N")
    if host not in config.robot.hosts:
        exit_with_error(f"--for {host}: this cell offers {', '.join(config.robot.hosts)}")
    if host != "pc" and not apply:
        exit_with_error("--for goes with --apply: the table shows every host")


def _axial_gain(client: "ConfiguredCell", gains: "Gains") -> float:
    """Return the force gain along the tool's axis [m/(N s)]."""
    import numpy as np

    from common.motion.convert import pose_of

    axis = (pose_of(client.state()) * client.config.tool.T_flange_tcp.pose).rotation[:, 2]
    return float((axis * axis) @ np.array(gains.force_i_m_per_Ns))


def _advices(client: "ConfiguredCell", measured: "MeasuredCell", gains: "Gains") -> "list[Advice]":
    from tuning.advice import advise

    return [
        advise(
            client.config,
            measured,
            host,
            force_now=_axial_gain(client, gains),
            torque_now=max(gains.torque_i_rad_per_Nms),
        )
        for host in client.config.robot.hosts
        if host == "pc" or measured.controller is not None
    ]


def _apply(client: "ConfiguredCell", advices: "list[Advice]", host: str) -> None:
    gains = next((advice.gains for advice in advices if advice.host == host), None)
    if gains is None:
        exit_with_error(f"--for {host}: its loop was not measured, so no gains are set")
    client.force.gains(
        force_i_m_per_Ns=gains.force_i_m_per_Ns, torque_i_rad_per_Nms=gains.torque_i_rad_per_Nms
    )
    print_note(f"gains for loop host {host} set until the regulator ends")

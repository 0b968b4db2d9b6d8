"""Verb `demo`: the main task on a simulated cell, with a result table and two pictures."""

import json
import tempfile
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option

from cli.context import NOT_WELL, OK, default_cell_file, exit_code_of, exit_with_error
from cli.numbers import from_milli
from cli.panel import NoPanel
from cli.record import NoRecorder
from cli.verbs_force import known_law
from forcemesh.errors import ForcemeshError
from forcemesh.messages import Host, Mode

if TYPE_CHECKING:
    from rich.console import Console

    from cli.demo.measures import Result
    from cli.demo.scenario import ScenarioPlan, Trace
    from common.config.cell import CellConfig

PLATE = "Plate and robot"
JOB = "Task"

# fmt: off
CellFile = Annotated[Path | None, Option("--cell", metavar="FILE", help="Cell file with a section `sim`; default: cells/demo.yaml.")]
ModeOption = Annotated[Mode, Option("--mode", rich_help_panel=JOB, help="Motion controlled by force feedback.")]
Setpoint = Annotated[float | None, Option("--setpoint", rich_help_panel=JOB, help="Final press force [N]; default: 0, in mode both 10.")]
Force = Annotated[float, Option("--force", rich_help_panel=JOB, help="Initial press force [N].")]
HostOption = Annotated[Host, Option("--host", rich_help_panel=JOB, help="Host of the control loop.")]
LawOption = Annotated[str | None, Option("--law", metavar="LAW", callback=known_law, rich_help_panel=JOB, help="Control law: plain, adaptive, or an added one; default: the cell file's.")]
Stiffness = Annotated[float | None, Option("--stiffness", rich_help_panel=PLATE, help="Plate stiffness [N/m].")]
DelayMs = Annotated[float | None, Option("--delay-ms", rich_help_panel=PLATE, help="Controller delay [ms].")]
TiltDeg = Annotated[float | None, Option("--tilt-deg", rich_help_panel=PLATE, help="Plate tilt [deg]; default: 0, in modes orientation and both 5.")]
Seed = Annotated[int | None, Option("--seed", rich_help_panel=PLATE, help="Seed of the sensor noise.")]
AsStepMs = Annotated[float | None, Option("--as-step-ms", rich_help_panel=PLATE, help="Emulated controller: duration of one AS step [ms].")]
Pessimistic = Annotated[bool, Option("--pessimistic", rich_help_panel=PLATE, help="Emulated controller: worst case wherever AS behaviour is unknown.")]
Virtual = Annotated[bool, Option("--virtual", help="Run in one process on a virtual clock, faster than real time.")]
Linger = Annotated[float, Option("--linger", min=0.0, help="Time that the cell stays up after a failure [s].")]
Out = Annotated[Path, Option("--out", help="Output folder for plot and picture.")]
AsJson = Annotated[bool, Option("--json", help="Print one JSON object on standard output.")]
# fmt: on


def demo(
    *,
    cell_file: CellFile = None,
    mode: ModeOption = "position",
    setpoint: Setpoint = None,
    force: Force = 30.0,
    host: HostOption = "pc",
    law: LawOption = None,
    stiffness: Stiffness = None,
    delay_ms: DelayMs = None,
    tilt_deg: TiltDeg = None,
    seed: Seed = None,
    as_step_ms: AsStepMs = None,
    pessimistic: Pessimistic = False,
    virtual: Virtual = False,
    linger: Linger = 5.0,
    out: Out = Path("out"),
    as_json: AsJson = False,
    no_panel: NoPanel = False,
    no_recorder: NoRecorder = False,
) -> None:
    """Run the main task: press on a plate, then control the force to its set point."""
    from rich.console import Console

    from cli.demo import cell as cells
    from cli.demo.scenario import ScenarioPlan, live_progress, play_real, play_virtual

    screen = Console(stderr=True)
    _make_folder(out)
    setpoint_N = cells.DEFAULT_SETPOINT_N[mode] if setpoint is None else setpoint
    plan = ScenarioPlan(mode=mode, host=host, press_N=force, setpoint_N=setpoint_N)
    try:
        cell = cells.demo_cell(
            cell_file or default_cell_file(),
            cells.DemoOverrides(
                tilt_deg=cells.DEFAULT_TILT_DEG[mode] if tilt_deg is None else tilt_deg,
                stiffness_N_m=stiffness,
                delay_s=from_milli(delay_ms),
                seed=seed,
                as_step_s=from_milli(as_step_ms),
                pessimistic=pessimistic,
                law=law,
            ),
        )
        cells.check_plan(cell, plan)
        with live_progress(screen, plan) as progress:
            real = partial(play_real, linger_s=linger, panel=not no_panel, recorder=not no_recorder)
            trace = (play_virtual if virtual else real)(cell, plan, progress)
    except ForcemeshError as error:
        _print_error(screen, error)
        if as_json:
            print(json.dumps({"settled": False, "error": str(error)}))
        raise Exit(exit_code_of(error)) from None
    result = report(screen, cell, plan, trace=trace, out=out)
    if as_json:
        print(json.dumps(asdict(result)))
    raise Exit(OK if result.settled else NOT_WELL)


def _print_error(screen: "Console", error: ForcemeshError) -> None:
    from rich.markup import escape

    text = escape(str(error).removeprefix("demo: "))  # errors of a plan carry this prefix
    screen.print(f"[red]demo:[/red] {text}", highlight=False, soft_wrap=True)


def _make_folder(out: Path) -> None:
    """Check before the run that its results can be written."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        exit_with_error(f"--out {out}: cannot be written: {error.strerror}; choose another folder")


def report(
    screen: "Console", cell: "CellConfig", plan: "ScenarioPlan", *, trace: "Trace", out: Path
) -> "Result":
    """Print the table, write plot and picture, and report a missing picture."""
    from cli.demo import measures
    from cli.demo.cell import plate_of, surface_of
    from control.gain_rule import tune
    from sim.robot.render import RenderUnavailable

    surface = surface_of(cell)
    result = measures.measure(trace, plan, surface, tune(cell).tau_s)
    screen.print(measures.table(result, plan, trace.started))
    measures.plot(trace, plan, surface, out / "demo.png")
    screen.print(f"plot: {out / 'demo.png'}", highlight=False, soft_wrap=True)
    try:
        sample = measures.pictured(trace, plan)
        measures.picture(plate_of(cell), surface, sample, out / "demo-scene.png")
        screen.print(f"picture: {out / 'demo-scene.png'}", highlight=False, soft_wrap=True)
    except RenderUnavailable as error:
        screen.print(f"[yellow]no picture:[/yellow] {error}", highlight=False, soft_wrap=True)
    return result

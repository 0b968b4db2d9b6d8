"""Verb `check axes`: comparison of the sensor installation with the cell file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.context import (
    NOT_WELL,
    OK,
    USAGE,
    CellOption,
    JsonOption,
    answers_yes,
    client_of,
    exit_with_error,
    find_cell_file,
    one_line_errors,
)
from cli.payload import Axes, AxesOption

if TYPE_CHECKING:
    from common.config.cell import CellConfig
    from identification.installation.terms import ExpectedInstallation, Installation

check = typer.Typer(no_args_is_help=True, help="Check the installation of a cell.")

POSES, SPEED_MM_S, DWELL_S = 6, 100.0, 0.3

FromFile = Annotated[
    Path | None,
    typer.Option("--from", metavar="CSV", help="Do not move the arm: evaluate a recording."),
]
Push = Annotated[bool, typer.Option("--push", help="Do not move the arm: push by hand.")]
Yes = Annotated[bool, typer.Option("--yes", help="Do not ask whether the workspace is free.")]
Mass = Annotated[
    float | None,
    typer.Option(min=0.001, help="True mass below the sensor [kg]; default: cell file."),
]
Speed = Annotated[float, typer.Option(min=1.0, max=1000.0, help="Speed of the moves [mm/s].")]


@check.callback()
def _group() -> None:
    """Keep `axes` a subcommand while it is the only check."""


@check.command()
def axes(
    *,
    from_file: FromFile = None,
    push: Push = False,
    yes: Yes = False,
    mass: Mass = None,
    speed: Speed = SPEED_MM_S,
    wrench_axes: Axes = AxesOption.AUTO,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Check axes, signs and units of the sensor; print corrections for the cell file.

    Without an option the arm rotates the tool through six poses, after a person has confirmed that
    the workspace is free; the weight serves as reference. This is not a safety function.
    """
    if push and from_file is not None:
        exit_with_error("--push and --from cannot be combined: choose one", USAGE)
    if wrench_axes is not AxesOption.AUTO and from_file is None:
        exit_with_error("--wrench-axes requires --from: otherwise the sensor itself is read", USAGE)
    from cli.check_axes.result import print_installation

    with one_line_errors():
        path = find_cell_file(cell)
        found, source = (
            _by_file(path, from_file, wrench_axes, mass)
            if from_file is not None
            else _by_hand(path)
            if push
            else _by_arm(path, mass, speed, yes=yes)
        )
    print_installation(found, source, as_json=as_json)
    raise typer.Exit(OK if found.verdict == "right" else NOT_WELL)


def _expected_installation(cell: "CellConfig", mass_kg: float | None) -> "ExpectedInstallation":
    from dataclasses import replace

    from identification.installation.terms import ExpectedInstallation

    expected = ExpectedInstallation.of(cell)
    return expected if mass_kg is None else replace(expected, mass_kg=mass_kg)


def _by_file(
    path: Path, recording: Path, option: AxesOption, mass_kg: float | None
) -> "tuple[Installation, str]":
    from cli.payload import named_axes
    from common.config.load import load_cell
    from forcemesh.errors import DataError
    from identification.installation.check import judge_recording
    from identification.recording import read_recording

    expected = _expected_installation(load_cell(path), mass_kg)
    try:
        data = read_recording(recording)
    except DataError as error:  # code 1 means that the installation is wrong
        exit_with_error(str(error), USAGE)
    chosen_axes, found = judge_recording(data, named_axes(option), expected)
    return found, f"{recording} in {chosen_axes} axes, against {path}"


def _by_hand(path: Path) -> "tuple[Installation, str]":
    from cli.calibration.screen import screen
    from cli.check_axes.push import PushTest
    from cli.check_axes.result import report_axes_to_cell
    from identification.installation.terms import ExpectedInstallation

    with client_of(path) as (cell, bus), screen(with_time=False) as output:
        try:
            found = PushTest(bus, cell, output).run(ExpectedInstallation.of(cell))
        except KeyboardInterrupt:
            exit_with_error("interrupted: no result", NOT_WELL)
        report_axes_to_cell(bus, found)
    return found, f"pushes by hand, against {path}"


def _by_arm(
    path: Path, mass_kg: float | None, speed_mm_s: float, *, yes: bool
) -> "tuple[Installation, str]":
    from cli.calibration import by_arm
    from cli.calibration.screen import screen
    from cli.calibration.wizard import WizardTiming
    from cli.check_axes.result import report_axes_to_cell
    from identification.dwells import samples_of
    from identification.excitation.plan import PlanOptions
    from identification.installation.check import judge_installation

    with client_of(path) as (cell, bus):
        limit_mm_s = 1e3 * cell.limits.speed_m_s
        timing = WizardTiming(min(speed_mm_s, limit_mm_s) / 1e3, DWELL_S)
        options = by_arm.ArmOptions(PlanOptions(poses=POSES, verify_poses=0), timing, yes)
        plan = by_arm.calibration_plan(cell, bus, options)
        typer.echo(by_arm.motion_description(cell, plan, timing), err=True)
        if not yes and not answers_yes("is the workspace free, and may the arm move?"):
            exit_with_error("nothing was moved", NOT_WELL)
        with screen() as output:
            wizard, ended = by_arm.drive(cell, bus, plan, timing, output=output)
        if ended is not None:
            raise typer.Exit(ended)
        found = judge_installation(samples_of(wizard.dwells), _expected_installation(cell, mass_kg))
        report_axes_to_cell(bus, found)
        return found, f"{len(wizard.dwells)} poses of the arm, against {path}"

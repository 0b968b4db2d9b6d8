"""Verb `check axes`: comparison of the sensor installation with the cell file."""

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Exit, Option, Typer, echo

from cli.context import (
    NOT_WELL,
    OK,
    CellOption,
    JsonOption,
    cell_of,
    exit_with_error,
    find_cell_file,
    one_line_errors,
    print_note,
)
from cli.payload import Axes, AxesOption, named_axes
from forcemesh import topics
from forcemesh.errors import DataError, RefusedError
from forcemesh.requests import AxesRequest

if TYPE_CHECKING:
    from common.bus.configured_cell import ConfiguredCell
    from common.config.cell import CellConfig
    from forcemesh.messages import WrenchAtTcp
    from identification.installation.terms import ExpectedInstallation, Installation

check = Typer(no_args_is_help=True, help="Check the installation of a cell.")

POSES, SPEED_MM_S, DWELL_S = 6, 100.0, 0.3
REPORT_WITHIN_S = 2.0
HEADLINES = {
    "right": "right: axes, signs and units are those of the cell file",
    "wrong": "wrong:",
    "cannot tell": "cannot tell:",
}


@check.callback()
def _group() -> None:
    """Keep `axes` a subcommand while it is the only check."""


@check.command()
def axes(
    *,
    from_file: Annotated[
        Path | None,
        Option("--from", metavar="CSV", help="Do not move the arm: evaluate a recording."),
    ] = None,
    push: Annotated[bool, Option("--push", help="Do not move the arm: push by hand.")] = False,
    yes: Annotated[bool, Option("--yes", help="Do not ask whether the workspace is free.")] = False,
    mass: Annotated[
        float | None,
        Option(min=0.001, help="True mass below the sensor [kg]; default: cell file."),
    ] = None,
    speed: Annotated[
        float, Option(min=1.0, max=1000.0, help="Speed of the moves [mm/s].")
    ] = SPEED_MM_S,
    wrench_axes: Axes = "auto",
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Check axes, signs and units of the sensor; print corrections for the cell file.

    Without an option the arm rotates the tool through six poses, after a person has confirmed that
    the workspace is free; the weight serves as reference. This is not a safety function.
    """
    if push and from_file is not None:
        exit_with_error("--push and --from cannot be combined: choose one")
    if wrench_axes != "auto" and from_file is None:
        exit_with_error("--wrench-axes requires --from: otherwise the sensor itself is read")
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
    raise Exit(OK if found.verdict == "right" else NOT_WELL)


def _expected_installation(cell: "CellConfig", mass_kg: float | None) -> "ExpectedInstallation":

    from identification.installation.terms import ExpectedInstallation

    expected = ExpectedInstallation.of(cell)
    return expected if mass_kg is None else replace(expected, mass_kg=mass_kg)


def _by_file(
    path: Path, recording: Path, option: AxesOption, mass_kg: float | None
) -> "tuple[Installation, str]":
    from common.config.load import load_cell
    from identification.installation.check import judge_recording
    from identification.recording import read_recording

    expected = _expected_installation(load_cell(path), mass_kg)
    data = read_recording(recording)
    chosen_axes, found = judge_recording(data, named_axes(option), expected)
    return found, f"{recording} in {chosen_axes} axes, against {path}"


def _by_hand(path: Path) -> "tuple[Installation, str]":
    from cli.check_axes.push import PushTest
    from cli.terminal import screen
    from identification.installation.terms import ExpectedInstallation

    with cell_of(path) as cell, screen(with_time=False) as output:
        try:
            found = PushTest(cell, output).run(ExpectedInstallation.of(cell.config))
        except KeyboardInterrupt:
            exit_with_error("interrupted: no result", NOT_WELL)
        report_axes(path, cell, found, "push")
    return found, f"pushes by hand, against {path}"


def _by_arm(
    path: Path, mass_kg: float | None, speed_mm_s: float, *, yes: bool
) -> "tuple[Installation, str]":
    from cli.calibration import by_arm
    from identification.dwells import samples_of
    from identification.excitation.plan import PlanOptions
    from identification.installation.check import judge_installation

    with cell_of(path) as cell:
        limit_mm_s = 1e3 * cell.config.limits.speed_m_s
        speed_m_s = min(speed_mm_s, limit_mm_s) / 1e3
        plan_options = PlanOptions(POSES, 0, speed_m_s=speed_m_s, dwell_s=DWELL_S)
        options = by_arm.ArmOptions(plan_options, yes)
        question = "is the workspace free, and may the arm move?"
        wizard, ended = by_arm.confirm_and_drive(cell, options, question=question)
        if ended is not None:
            raise Exit(ended)
        expected = _expected_installation(cell.config, mass_kg)
        found = judge_installation(samples_of(wizard.dwells), expected)
        report_axes(path, cell, found, "arm")
        return found, f"{len(wizard.dwells)} poses of the arm, against {path}"


def report_axes(
    path: Path, cell: "ConfiguredCell", found: "Installation", method: Literal["arm", "push"]
) -> None:
    """Report to the cell that its axes are right; keep that in its calibration file."""
    if found.verdict != "right":
        return
    wrench = cell.wrench.wait(REPORT_WITHIN_S).fresh
    if wrench is None:
        print_note("warning: no wrench is published: the cell did not receive the result")
        return
    try:
        request = AxesRequest(calibration=wrench.calibration, torques=found.shows_torques)
        print_note(cell.ask(topics.AXES, request).text)
        print_note(_keep(path, cell, wrench, found, method=method))
    except (DataError, RefusedError) as error:
        print_note(f"warning: {error}")


def _keep(
    path: Path,
    cell: "ConfiguredCell",
    wrench: "WrenchAtTcp",
    found: "Installation",
    *,
    method: Literal["arm", "push"],
) -> str:
    """Add the result to the calibration file of a cell; return where, or why nowhere."""
    from common.config.calibration import CalibrationSection
    from common.config.load import CALIBRATION, load_cell, named_file

    used, file = load_cell(path).calibration, named_file(path, CALIBRATION)
    if (
        file is None
        or not isinstance(used, CalibrationSection)
        or used.revision != wrench.calibration
    ):
        return (
            "warning: the result counts until the next start: the cell does not use the "
            "calibration of a file; name one in the cell file, then run `forcemesh calibrate`, "
            "which checks the axes as well"
        )
    if not wrench.calibrated:
        return f"warning: the result is not kept: {wrench.calibration_fault}"
    arm, made_at = cell.config.robot.model, datetime.now(UTC).replace(microsecond=0)
    used.with_axes(arm, method, made_at, torques=found.shows_torques).save(file)
    return f"kept in {file}"


def print_installation(found: "Installation", source: str, *, as_json: bool) -> None:
    """Print verdict, findings with remedies, what was not observed, and the measured numbers."""
    if as_json:
        wiring = found.force_wiring
        report = {
            "verdict": found.verdict,
            "source": source,
            "findings": [
                {"code": each.code, "kind": each.kind, "text": each.text, "remedy": each.remedy}
                for each in found.findings
            ],
            "not_shown": found.unidentified,
            "force_channels_show": None if wiring is None else wiring.tolist(),
            "evidence": found.evidence,
        }
        echo(json.dumps(report, allow_nan=False))
        return
    echo(f"{source}\n{HEADLINES[found.verdict]}")
    for finding in found.findings:
        echo(f"  - {finding.text}\n    -> {finding.remedy}")
    for line in found.unidentified:
        echo(f"  not observed: {line}")
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in found.evidence.items())
    if numbers:
        echo(f"  ({numbers})")

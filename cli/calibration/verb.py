"""Verb `calibrate`: identification and verification of payload and sensor bias of a cell."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.context import (
    CONNECT_PATIENCE_S,
    USAGE,
    CellOption,
    exit_with_error,
    find_cell_file,
    one_line_errors,
)
from cli.payload import Axes, AxesOption

if TYPE_CHECKING:
    from cli.calibration import by_arm
    from cli.calibration.finish import Job
    from common.config.cell import CellConfig

USUAL_SPEED_MM_S = 100.0

Yes = Annotated[bool, typer.Option("--yes", help="Do not ask whether the workspace is free.")]
Poses = Annotated[int, typer.Option(min=6, max=40, help="Poses for the fit.")]
VerifyPoses = Annotated[
    int, typer.Option(min=0, max=20, help="Further poses for verification; 0 only with --manual.")
]
SpeedOption = Annotated[
    float | None,
    typer.Option(
        min=1.0, max=1000.0, help="Speed of the moves [mm/s]; default: 100, or less if limited."
    ),
]
DwellOption = Annotated[
    float, typer.Option(min=0.1, max=10.0, help="Averaging time at a pose [s].")
]
RotationOption = Annotated[
    float, typer.Option(min=30.0, max=180.0, help="Largest rotation of joints 4 to 6 [deg].")
]
MaxForce = Annotated[float, typer.Option(min=0.001, help="Largest residual force [N].")]
MaxTorque = Annotated[float, typer.Option(min=0.0001, help="Largest residual torque [N m].")]
Force = Annotated[
    bool, typer.Option("--force", help="Write a result that failed; it is never activated.")
]
Use = Annotated[
    bool,
    typer.Option(
        "--use",
        help="Activate a result that passed; default when the arm moves and --out is not set.",
    ),
]
Free = Annotated[
    bool,
    typer.Option("--free", help="The tool is free although a force is measured: a new tool."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Write the result to FILE only; with --use also activate it."
    ),
]
Manual = Annotated[bool, typer.Option("--manual", help="Do not move the arm: a person moves it.")]
AutoCapture = Annotated[
    bool, typer.Option("--auto-capture", help="With --manual: capture each new pose automatically.")
]
FromFile = Annotated[
    Path | None, typer.Option("--from", metavar="CSV", help="Do not move the arm: use a recording.")
]
VerifyWith = Annotated[
    Path | None, typer.Option(metavar="CSV", help="With --from: recording for verification.")
]
VerifyOnly = Annotated[
    bool, typer.Option("--verify-only", help="Verify the active calibration of the cell; no fit.")
]


@dataclass(frozen=True, slots=True)
class _Method:
    """Selected calibration method."""

    manual: bool
    auto_capture: bool
    recording: Path | None
    verify_with: Path | None
    verify_only: bool
    axes: AxesOption

    def mistake(self) -> str:
        """Return which options cannot be combined, or an empty string."""
        chosen = {
            "--manual": self.manual,
            "--from": self.recording is not None,
            "--verify-only": self.verify_only,
        }
        names = [name for name, is_chosen in chosen.items() if is_chosen]
        if len(names) > 1:
            return f"{' and '.join(names)} cannot be combined: choose one"
        if self.verify_with is not None and self.recording is None:
            return "--verify-with requires --from: the wizard measures its own poses"
        if self.axes is not AxesOption.AUTO and self.recording is None:
            return "--wrench-axes requires --from: the wizard reads the sensor itself"
        if self.auto_capture and not self.manual:
            return "--auto-capture requires --manual"
        return ""


@dataclass(frozen=True, slots=True)
class ResultDestination:
    """Destination of the result; --out alone never activates it."""

    out: Path | None
    use: bool
    force: bool
    moves_arm: bool

    @property
    def uses(self) -> bool:
        """Whether a result that passes is activated; default of the wizard that moves the arm."""
        return self.use or (self.moves_arm and self.out is None and not self.force)

    def mistake(self) -> str:
        """Return which options cannot be combined, or an empty string."""
        if self.use and self.force:
            return "--use and --force cannot be combined: a failed result is never activated"
        return ""


def calibrate(
    *,
    yes: Yes = False,
    poses: Poses = 10,
    verify_poses: VerifyPoses = 4,
    speed: SpeedOption = None,
    dwell: DwellOption = 0.5,
    turn: RotationOption = 120.0,
    max_force: MaxForce = 0.5,
    max_torque: MaxTorque = 0.05,
    force: Force = False,
    use: Use = False,
    free: Free = False,
    out: Out = None,
    manual: Manual = False,
    auto_capture: AutoCapture = False,
    from_file: FromFile = None,
    verify_with: VerifyWith = None,
    verify_only: VerifyOnly = False,
    wrench_axes: Axes = AxesOption.AUTO,
    cell: CellOption = None,
) -> None:
    """Identify payload and sensor bias, verify them at further poses, activate them.

    The arm moves through poses inside the workspace of the cell file, after a person has confirmed
    that it is free. A verified result is written to the calibration file of the cell and activated
    in the running cell at once. With --manual, --from or --out it is only written; --use activates
    it if verification passes. This is not a safety function.
    """
    method = _Method(manual, auto_capture, from_file, verify_with, verify_only, wrench_axes)
    destination = ResultDestination(out, use, force, moves_arm=not (manual or from_file))
    mistake = method.mistake() or destination.mistake()
    if mistake:
        exit_with_error(mistake, USAGE)
    with one_line_errors():
        path = find_cell_file(cell)
        job = _job(path, destination, (max_force, max_torque))
        if from_file is not None:
            code = _by_file(job, from_file, method)
        elif manual:
            code = _by_hand(job, method, (poses, verify_poses, dwell))
        else:
            if verify_poses == 0:
                exit_with_error(
                    "--verify-poses 0 requires --manual: the wizard verifies its fit", USAGE
                )
            options = _options(
                job.cell, (poses, verify_poses, turn), speed, dwell, assured=(yes, free)
            )
            code = _by_arm(job, options, verify_only=verify_only)
    raise typer.Exit(code)


def _job(path: Path, destination: ResultDestination, bounds: tuple[float, float]) -> "Job":
    from cli.calibration.finish import Job
    from cli.calibration.output_files import output_files
    from common.config.load import load_cell
    from identification.verification import VerificationBounds

    cell = load_cell(path, {"calibration": None})  # not needed, and possibly invalid
    files = output_files(cell, path, destination.out)
    if destination.out is not None and not destination.uses and not files.advice:
        exit_with_error(
            f"--out {destination.out} is the calibration file that the cell loads at start: use "
            "--use to activate the result, or another file name to write it only",
            USAGE,
        )
    return Job(
        cell, files, VerificationBounds(*bounds), force=destination.force, use=destination.uses
    )


def _options(
    cell: "CellConfig",
    poses: tuple[int, int, float],
    speed_mm_s: float | None,
    dwell_s: float,
    *,
    assured: tuple[bool, bool],
) -> "by_arm.ArmOptions":
    from math import radians

    from cli.calibration.by_arm import ArmOptions
    from cli.calibration.wizard import WizardTiming
    from identification.excitation.plan import PlanOptions

    count, verify_count, turn_deg = poses
    limit_mm_s = 1e3 * cell.limits.speed_m_s
    if speed_mm_s is not None and speed_mm_s > limit_mm_s:
        exit_with_error(
            f"--speed {speed_mm_s:g}: limits.speed_m_s allows {limit_mm_s:g} mm/s", USAGE
        )
    usual_mm_s = min(USUAL_SPEED_MM_S, limit_mm_s)
    timing = WizardTiming((usual_mm_s if speed_mm_s is None else speed_mm_s) / 1e3, dwell_s)
    return ArmOptions(PlanOptions(count, verify_count, radians(turn_deg)), timing, *assured)


def _by_arm(job: "Job", options: "by_arm.ArmOptions", *, verify_only: bool) -> int:
    from cli.calibration import by_arm
    from common.bus.configured_cell import ConfiguredCell

    run = by_arm.verify if verify_only else by_arm.calibrate
    with ConfiguredCell(job.cell, patience_s=CONNECT_PATIENCE_S) as client:
        return run(job, options, client)


def _by_hand(job: "Job", method: _Method, poses: tuple[int, int, float]) -> int:
    from cli.calibration import by_hand
    from cli.terminal import Keyboard
    from common.bus.configured_cell import ConfiguredCell

    count, verify_count, dwell_s = poses
    options = by_hand.HandOptions(count, verify_count, dwell_s, method.auto_capture)
    with ConfiguredCell(job.cell, patience_s=CONNECT_PATIENCE_S) as client:
        return by_hand.calibrate(job, options, client, Keyboard())


def _by_file(job: "Job", recording: Path, method: _Method) -> int:
    from cli.calibration.finish import calibrate_from_recording
    from cli.payload import named_axes

    axes = named_axes(method.axes)
    return calibrate_from_recording(job, recording, method.verify_with, axes)

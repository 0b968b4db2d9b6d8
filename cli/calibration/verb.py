"""Verb `calibrate`: identification and verification of payload and sensor bias of a cell."""

from functools import partial
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option

from cli.context import (
    CONNECT_PATIENCE_S,
    CellOption,
    exit_with_error,
    find_cell_file,
    one_line_errors,
)
from cli.payload import Axes, named_axes

if TYPE_CHECKING:
    from cli.calibration.finish import Job

USUAL_SPEED_MM_S = 100.0

Yes = Annotated[bool, Option("--yes", help="Do not ask whether the workspace is free.")]
Poses = Annotated[int, Option(min=6, max=40, help="Poses for the fit.")]
VerifyPoses = Annotated[
    int, Option(min=0, max=20, help="Further poses for verification; 0 only with --manual.")
]
SpeedOption = Annotated[
    float | None,
    Option(
        min=1.0, max=1000.0, help="Speed of the moves [mm/s]; default: 100, or less if limited."
    ),
]
DwellOption = Annotated[float, Option(min=0.1, max=10.0, help="Averaging time at a pose [s].")]
RotationOption = Annotated[
    float, Option(min=30.0, max=180.0, help="Largest rotation of joints 4 to 6 [deg].")
]
MaxForce = Annotated[float, Option(min=0.001, help="Largest residual force [N].")]
MaxTorque = Annotated[float, Option(min=0.0001, help="Largest residual torque [N m].")]
Force = Annotated[
    bool, Option("--force", help="Write a result that failed; it is never activated.")
]
Use = Annotated[
    bool,
    Option(
        "--use",
        help="Activate a result that passed; default when the arm moves and --out is not set.",
    ),
]
Free = Annotated[
    bool,
    Option("--free", help="The tool is free although a force is measured: a new tool."),
]
Out = Annotated[
    Path | None,
    Option(metavar="FILE", help="Write the result to FILE only; with --use also activate it."),
]
Manual = Annotated[bool, Option("--manual", help="Do not move the arm: a person moves it.")]
AutoCapture = Annotated[
    bool, Option("--auto-capture", help="With --manual: capture each new pose automatically.")
]
FromFile = Annotated[
    Path | None, Option("--from", metavar="CSV", help="Do not move the arm: use a recording.")
]
VerifyWith = Annotated[
    Path | None, Option(metavar="CSV", help="With --from: recording for verification.")
]
VerifyOnly = Annotated[
    bool, Option("--verify-only", help="Verify the active calibration of the cell; no fit.")
]


def puts_into_use(*, use: bool, out: Path | None, force: bool, moves_arm: bool) -> bool:
    """Return whether a result that passes is activated: default of the wizard that moves the arm.

    --out alone never activates it.
    """
    return use or (moves_arm and out is None and not force)


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
    wrench_axes: Axes = "auto",
    cell: CellOption = None,
) -> None:
    """Identify payload and sensor bias, verify them at further poses, activate them.

    The arm moves through poses inside the workspace of the cell file, after a person has confirmed
    that it is free. A verified result is written to the calibration file of the cell and activated
    in the running cell at once. With --manual, --from or --out it is only written; --use activates
    it if verification passes. This is not a safety function.
    """
    moves_arm = not (manual or from_file)
    methods = {"--manual": manual, "--from": from_file, "--verify-only": verify_only}
    chosen = [name for name, value in methods.items() if value]
    if len(chosen) > 1:
        exit_with_error(f"{' and '.join(chosen)} cannot be combined: choose one")
    if from_file is None and verify_with is not None:
        exit_with_error("--verify-with requires --from: the wizard measures its own poses")
    if from_file is None and wrench_axes != "auto":
        exit_with_error("--wrench-axes requires --from: the wizard reads the sensor itself")
    if auto_capture and not manual:
        exit_with_error("--auto-capture requires --manual")
    if use and force:
        exit_with_error("--use and --force cannot be combined: a failed result is never activated")
    with one_line_errors():
        from cli.calibration.finish import calibrate_from_recording
        from common.bus.configured_cell import ConfiguredCell

        uses = puts_into_use(use=use, out=out, force=force, moves_arm=moves_arm)
        job = _job(find_cell_file(cell), out, (max_force, max_torque), force=force, uses=uses)
        if from_file is not None:
            axes = named_axes(wrench_axes)
            raise Exit(calibrate_from_recording(job, from_file, verify_with, axes))
        if manual:
            run = _by_hand(job, (poses, verify_poses, dwell), auto_capture=auto_capture)
        else:
            counts = (poses, verify_poses, turn)
            run = _by_arm(job, counts, speed, dwell, assured=(yes, free), verify_only=verify_only)
        with ConfiguredCell(job.cell, patience_s=CONNECT_PATIENCE_S) as client:
            code = run(client)
    raise Exit(code)


def _job(
    path: Path, out: Path | None, bounds: tuple[float, float], *, force: bool, uses: bool
) -> "Job":
    from cli.calibration.finish import Job
    from cli.calibration.output_files import output_files
    from common.config.load import load_cell
    from identification.verification import VerificationBounds

    cell = load_cell(path, {"calibration": None})  # not needed, and possibly invalid
    files = output_files(cell, path, out)
    if out is not None and not uses and not files.advice:
        exit_with_error(
            f"--out {out} is the calibration file that the cell loads at start: use --use to "
            "activate the result, or another file name to write it only"
        )
    return Job(cell, files, VerificationBounds(*bounds), force=force, use=uses)


def _by_hand(job: "Job", counts: tuple[int, int, float], *, auto_capture: bool) -> "partial[int]":
    """Return the calibration in which a person moves the arm."""
    from cli.calibration import by_hand
    from cli.terminal import typed_line

    options = by_hand.HandOptions(*counts, auto_capture)
    return partial(by_hand.calibrate, job, options, typed_line)


def _by_arm(
    job: "Job",
    counts: tuple[int, int, float],
    speed_mm_s: float | None,
    dwell_s: float,
    *,
    assured: tuple[bool, bool],
    verify_only: bool,
) -> "partial[int]":
    """Return the calibration or the verification in which the arm moves."""
    from cli.calibration import by_arm
    from identification.excitation.plan import PlanOptions

    poses, verify_poses, turn_deg = counts
    if verify_poses == 0:
        exit_with_error("--verify-poses 0 requires --manual: the wizard verifies its fit")
    limit_mm_s = 1e3 * job.cell.limits.speed_m_s
    if speed_mm_s is None:
        speed_mm_s = min(USUAL_SPEED_MM_S, limit_mm_s)
    elif speed_mm_s > limit_mm_s:
        exit_with_error(f"--speed {speed_mm_s:g}: limits.speed_m_s allows {limit_mm_s:g} mm/s")
    plan_options = PlanOptions(poses, verify_poses, radians(turn_deg), speed_mm_s / 1e3, dwell_s)
    options = by_arm.ArmOptions(plan_options, *assured)
    return partial(by_arm.verify if verify_only else by_arm.calibrate, job, options)

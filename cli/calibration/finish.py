"""Conclusion of every calibration: installation check, verdict, files, use by the cell, report."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from typer import echo

from cli.calibration.output_files import OutputFiles, back_up
from cli.calibration.page import save_page
from cli.context import NO_ANSWER, NOT_WELL, OK, REFUSED, print_note
from cli.payload_tables import print_fit
from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from forcemesh.errors import BusError, RefusedError
from identification.dwells import Dwell, dwells_of_purpose, recording_of, save_dwells
from identification.errors import CalibrationError
from identification.evidence import Evidence, Findings, findings_of
from identification.identify import identify_recording
from identification.installation.check import judge_recording
from identification.installation.terms import ExpectedInstallation, Installation
from identification.recording import WrenchAxes, WrenchRecording, read_recording
from identification.static_poses import sort_into_poses
from identification.verification import VerificationBounds
from services.wrench.active_calibration import active_calibration

SEND_PATIENCE_S = 0.5


@dataclass(frozen=True, slots=True)
class Job:
    """Cell to calibrate, output files, limits and use of the result."""

    cell: CellConfig
    files: OutputFiles
    bounds: VerificationBounds
    force: bool = False  # write a failed result too, without using it
    use: bool = False  # put a passed result into use


def calibrate_from_recording(
    job: Job, recording: Path, verification: Path | None, axes: WrenchAxes | None
) -> int:
    """Fit a recording, verify by another one if given, write, send if the cell is up.

    Raises DataError when a recording cannot be used.
    """
    data = read_recording(recording)
    refuse_wrong_installation(job, data, axes)
    chosen_axes, fit, reason = identify_recording(data, axes, job.cell.gravity_direction_in_base)
    if reason:
        print_note(reason)
    verify = None
    if verification is not None:
        verify = sort_into_poses(read_recording(verification).samples(chosen_axes)).means
    evidence = Evidence("recording", data, chosen_axes, fit, verify)
    try:
        with ConfiguredCell(job.cell, patience_s=SEND_PATIENCE_S) as cell:
            return conclude(job, evidence, cell)
    except BusError:
        return conclude(job, evidence, None)


def refuse_wrong_axes(job: Job, dwells: Sequence[Dwell]) -> Installation:
    """Raise CalibrationError when the dwells of the fit contradict the installation.

    Returns what they show: with force, a contradiction is only a warning.
    """
    recording = recording_of(dwells_of_purpose(dwells, "fit"), job.files.readings)
    return refuse_wrong_installation(job, recording, "sensor")


def refuse_wrong_installation(
    job: Job, recording: WrenchRecording, axes: WrenchAxes | None
) -> Installation:
    """Raise CalibrationError when axes, signs or units are not those of the cell file.

    A fit could hide wrong axes, as some of them are explained by a payload; the force loop would
    then have positive feedback. With force, only a warning is printed.

    Args:
        job: Expected installation, and whether to continue in spite of a finding.
        recording: Static readings in many attitudes.
        axes: Axes in which the wrench was recorded; None: detect them.
    """
    expected = ExpectedInstallation.of(job.cell)
    found = judge_recording(recording, axes, expected)[1]
    if expected.mass_kg is None and "mass_kg" in found.evidence:
        print_note(
            f"the measured tool mass is {found.evidence['mass_kg']:.3g} kg, the cell file has "
            "none: check it. A wrong unit of force (kgf, pounds) is detectable only here"
        )
    if found.rejection_reason is None:
        return found
    if job.force:
        print_note(f"warning: {found.rejection_reason}")
        return found
    raise CalibrationError(
        f"{found.rejection_reason}; no calibration is made (`forcemesh check axes` shows more, "
        "--force makes one nevertheless)"
    )


def conclude(job: Job, evidence: Evidence, cell: ConfiguredCell | None) -> int:
    """Print the result and its verdict, write it, put it into use if requested and passed.

    Args:
        job: Cell, files and options.
        evidence: Readings and their fit.
        cell: The running cell; None when it is not up.
    """
    found = findings_of(job.cell, evidence, job.bounds)
    for warning in found.report["warnings"]:
        print_note(f"warning: {warning}")
    print_fit(found.report)
    echo(found.verdict.text)
    return store_result(job, found, cell)


def store_result(job: Job, found: Findings, cell: ConfiguredCell | None) -> int:
    """Write the result; put it into use if requested and passed. Return the exit code.

    The last line reports whether the cell uses it; requested and not used is never exit code 0.
    """
    if found.verdict.passed is False and not job.force:
        page = job.files.calibration.with_suffix(".failed.html")  # a good report is kept
        save_page(found, page)
        echo("check for contact, a loose tool or cable, a wrong T_flange_sensor; --force writes it")
        echo(f"nothing was written or put into use; the report is {page}")
        return NOT_WELL
    if found.verdict.passed is False:
        return _keep_unused(job.files, found, "it failed", NOT_WELL)
    if not job.use:
        return _keep_unused(job.files, found, "only --use puts it into use", OK)
    objection = active_calibration(found.section, job.cell).objection
    if found.verdict.passed is None:
        objection = "no fresh pose has verified it (--verify-with, or --verify-poses above 0)"
    if objection:
        return _keep_unused(job.files, found, objection, NOT_WELL)
    return _put_into_use(job.files, found, cell)


def _put_into_use(files: OutputFiles, found: Findings, cell: ConfiguredCell | None) -> int:
    """Send the result to the running cell; when accepted, write it for the next start too."""
    if cell is None:
        _write(files.calibration, found)
        echo(files.advice or "the cell is not up: it takes the file when it is started")
        return OK
    try:
        reply = cell.calibrate(found.section.model_dump_json())
    except RefusedError as error:
        reason = f"the running cell refused it ({error.code}): {error.text}"
        return _keep_unused(files, found, f"{reason}; it keeps its previous calibration", REFUSED)
    except BusError as error:
        _write(files.unused, found)
        echo(
            f"{error}; whether the cell uses calibration {found.section.revision} is not known: "
            f"`forcemesh status` shows it; the file is {files.unused}"
        )
        return NO_ANSWER
    _write(files.calibration, found)
    if files.advice:
        echo(f"{files.advice} after its next start as well")
    echo(reply.text)
    return OK


def _keep_unused(files: OutputFiles, found: Findings, reason: str, code: int) -> int:
    """Write a result that the cell does not use, report the reason, and return the exit code."""
    _write(files.unused, found)
    advice = files.advice or f"the file is {files.unused}"
    echo(f"the cell does not use it: {reason}; {advice}")
    return code


def _write(path: Path, found: Findings) -> None:
    """Write calibration and page; previous files are kept as `.before`."""
    back_up(path)
    found.section.save(path)
    echo(f"calibration {found.section.revision} written to {path}")
    page = path.with_suffix(".html")
    back_up(page)
    save_page(found, page)
    echo(f"report: {page}")


def save_readings(job: Job, dwells: Sequence[Dwell]) -> None:
    """Write the recorded readings, if any. Raises DataError when that is not possible."""
    if not dwells:
        return
    path = job.files.readings
    back_up(path)
    save_dwells(dwells, path)
    count = sum(len(dwell) for dwell in dwells)
    print_note(f"{count} readings at {len(dwells)} poses written to {path}")

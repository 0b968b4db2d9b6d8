"""Conclusion of every calibration: verdict, files, use by the cell, report and exit code."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cli.calibration.output_files import OutputFiles, back_up
from cli.calibration.page import save_page
from cli.context import NO_ANSWER, NOT_WELL, OK, REFUSED
from cli.payload_tables import print_fit
from common.config.cell import CellConfig
from forcemesh.errors import BusError
from identification.dwells import Dwell, save_dwells
from identification.evidence import Evidence, Findings, findings_of
from identification.verification import VerificationBounds
from services.wrench.active_calibration import active_calibration

if TYPE_CHECKING:
    from forcemesh.bus import Bus


@dataclass(frozen=True, slots=True)
class Job:
    """Cell to calibrate, output files, limits and use of the result."""

    cell: CellConfig
    files: OutputFiles
    bounds: VerificationBounds
    force: bool = False  # write a failed result too, without using it
    use: bool = False  # put a passed result into use


def conclude(job: Job, evidence: Evidence, bus: "Bus | None") -> int:
    """Print the result and its verdict, write it, put it into use if requested and passed.

    Args:
        job: Cell, files and options.
        evidence: Readings and their fit.
        bus: Bus of the running cell; None when it is not up.
    """
    found = findings_of(job.cell, evidence, job.bounds)
    for warning in found.report["warnings"]:
        typer.echo(f"warning: {warning}", err=True)
    print_fit(found.report)
    typer.echo(found.verdict.text)
    return store_result(job, found, bus)


def store_result(job: Job, found: Findings, bus: "Bus | None") -> int:
    """Write the result; put it into use if requested and passed. Return the exit code.

    The last line reports whether the cell uses it; requested and not used is never exit code 0.
    """
    if found.verdict.passed is False:
        return _store_failed_result(job, found)
    if not job.use:
        _write(job.files.unused, found)
        typer.echo(_not_used_text(job.files, "only --use puts it into use"))
        return OK
    objection = active_calibration(found.section, job.cell).objection
    if found.verdict.passed is None:
        objection = "no fresh pose has verified it (--verify-with, or --verify-poses above 0)"
    if objection:
        _write(job.files.unused, found)
        typer.echo(_not_used_text(job.files, objection))
        return NOT_WELL
    return _put_into_use(job, found, bus)


def _store_failed_result(job: Job, found: Findings) -> int:
    if job.force:
        _write(job.files.unused, found)
        typer.echo(_not_used_text(job.files, "it failed"))
        return NOT_WELL
    page = job.files.failed_page
    save_page(found, page)
    typer.echo(
        "check for contact, a loose tool or cable, a wrong T_flange_sensor; --force writes it"
    )
    typer.echo(f"nothing was written or put into use; the report is {page}")
    return NOT_WELL


def _put_into_use(job: Job, found: Findings, bus: "Bus | None") -> int:
    """Send the result to the running cell; when accepted, write it for the next start too."""
    from cli.calibration.send import send_calibration

    files, revision = job.files, found.section.revision
    if bus is None:
        _write(files.calibration, found)
        typer.echo(files.advice or "the cell is not up: it takes the file when it is started")
        return OK
    try:
        reply = send_calibration(bus, found.section)
    except BusError as error:
        _write(files.unused, found)
        typer.echo(
            f"{error}; whether the cell uses calibration {revision} is not known: `forcemesh "
            f"status` shows it; the file is {files.unused}"
        )
        return NO_ANSWER
    if not reply.accepted:
        _write(files.unused, found)
        reason = f"the running cell refused it ({reply.code}): {reply.text}"
        typer.echo(_not_used_text(files, f"{reason}; it keeps its previous calibration"))
        return REFUSED
    _write(files.calibration, found)
    if files.advice:
        typer.echo(f"{files.advice} after its next start as well")
    typer.echo(reply.text)
    return OK


def _not_used_text(files: OutputFiles, reason: str) -> str:
    return f"the cell does not use it: {reason}; {files.advice or f'the file is {files.unused}'}"


def _write(path: Path, found: Findings) -> None:
    """Write calibration and page; previous files are kept as `.before`."""
    back_up(path)
    found.section.save(path)
    typer.echo(f"calibration {found.section.revision} written to {path}")
    page = path.with_suffix(".html")
    back_up(page)
    save_page(found, page)
    typer.echo(f"report: {page}")


def save_readings(job: Job, dwells: Sequence[Dwell]) -> None:
    """Write the recorded readings, if any. Raises DataError when that is not possible."""
    if not dwells:
        return
    path = job.files.readings
    back_up(path)
    save_dwells(dwells, path)
    count = sum(len(dwell) for dwell in dwells)
    typer.echo(f"{count} readings at {len(dwells)} poses written to {path}", err=True)

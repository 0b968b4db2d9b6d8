"""The end of every calibration: print, judge, write, send, report. Returns the exit code."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cli.calibration.evidence import Evidence, Findings, findings_of
from cli.calibration.page import save_page
from cli.calibration.places import Places, keep_before
from cli.calibration.rows import Dwell, save
from cli.calibration.verdict import Bounds
from cli.context import NOT_WELL, OK
from cli.payload_tables import print_fit
from common.cell import Cell
from common.errors import BusError

if TYPE_CHECKING:
    from common.endpoints import Bus


@dataclass(frozen=True, slots=True)
class Job:
    """What is calibrated, and what becomes of the result."""

    cell: Cell
    places: Places
    bounds: Bounds
    force: bool = False  # write and send it although it failed


def conclude(job: Job, evidence: Evidence, bus: "Bus | None") -> int:
    """Print what was found, judge it; write it, and give it to the running cell, unless it failed.

    Args:
        job: What is calibrated.
        evidence: Readings and their fit.
        bus: Way to the running cell; None when it is not up.
    """
    found = findings_of(job.cell, evidence, job.bounds)
    for warning in found.report["warnings"]:
        typer.echo(f"warning: {warning}", err=True)
    print_fit(found.report)
    typer.echo(found.verdict.text)
    return settle(job, found, bus)


def settle(job: Job, found: Findings, bus: "Bus | None") -> int:
    """Write what was found, and give it to the running cell, unless it failed."""
    failed = found.verdict.passed is False
    page = job.places.report(failed=failed)
    if failed and not job.force:
        save_page(found, page)
        typer.echo(f"nothing was written or sent; the report is {page}")
        typer.echo(
            "look for contact, a loose tool or cable, a wrong T_flange_sensor; --force uses it"
        )
        return NOT_WELL
    _write(job, found, page)
    _hand_over(found, bus)
    return NOT_WELL if failed else OK


def _write(job: Job, found: Findings, page: Path) -> None:
    places = job.places
    keep_before(places.calibration)
    found.section.save(places.calibration)
    typer.echo(f"calibration {found.section.revision} written to {places.calibration}")
    if places.advice:
        typer.echo(places.advice)
    keep_before(page)
    save_page(found, page)
    typer.echo(f"report: {page}")


def _hand_over(found: Findings, bus: "Bus | None") -> None:
    from cli.calibration.send import send

    if bus is None:
        typer.echo("the cell is not up: it takes the file when it is started")
        return
    try:
        reply = send(bus, found.section)
    except BusError as error:
        typer.echo(f"{error}; the file stays, the cell takes it when it is started", err=True)
        return
    if reply.accepted:
        typer.echo(reply.text)
    else:
        text = f"the running cell refused it ({reply.code}): {reply.text}"
        typer.echo(f"{text}; the file stays, the cell takes it when it is started", err=True)


def keep_readings(job: Job, dwells: Sequence[Dwell]) -> None:
    """Write what was recorded, however it ended. Raises DataError when that is not possible."""
    if not dwells:
        return
    path = job.places.readings
    keep_before(path)
    save(dwells, path)
    count = sum(len(dwell) for dwell in dwells)
    typer.echo(f"{count} readings at {len(dwells)} poses written to {path}", err=True)

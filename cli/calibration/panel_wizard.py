"""Calibration wizard of the panel: the functions of `forcemesh calibrate` with JSON line output.

The panel starts it as a separate process, `python -m cli.calibration.panel_wizard`: it holds the
arm on SIGTERM, as the command does at Ctrl-C, and a crash does not affect the panel. It prints its
plan, waits for the line `go` on standard input, and then prints its progress:

    {"plan": "..."}  {"progress": 0.4, "text": "..."}  {"note": "..."}  {"left": {...}}  {"end": 0}
"""

import contextlib
import json
import sys
import time
from collections.abc import Iterator
from math import radians
from pathlib import Path
from typing import IO, Annotated, Any

import numpy as np
import typer

from cli.calibration import by_arm
from cli.calibration.contact import refuse_loaded_tool
from cli.calibration.finish import Job, settle
from cli.calibration.places import places_of
from cli.calibration.wizard import WizardTiming
from cli.context import CONNECT_PATIENCE_S, NOT_WELL, USAGE
from cli.payload_tables import found_parameters
from common.bus.cell_bus import open_bus
from common.config.load import load_cell
from forcemesh.bus import Bus
from forcemesh.errors import ForcemeshError
from forcemesh.topics import CLIENT
from identification.evidence import Evidence, findings_of
from identification.excitation.plan import PlanOptions
from identification.verification import VerificationBounds

EACH_S = 0.2  # update interval of the progress bar
SPEED_M_S, DWELL_S, TURN_DEG = 0.1, 0.5, 120.0


class JsonLineOutput:
    """Standard output of this process, one JSON object per line; printed text becomes notes."""

    def __init__(self, out: IO[str]) -> None:
        """Write to a stream."""
        self._out = out
        self._rest = ""
        self._last_s = 0.0

    def say(self, **what: Any) -> None:
        """Write one object."""
        self._out.write(json.dumps(what) + "\n")
        self._out.flush()

    def note(self, text: str) -> None:
        """Write one line that stays visible."""
        self.say(note=text)

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Write the progress, at most some times a second."""
        now_s = time.monotonic()
        if now_s - self._last_s >= EACH_S:
            self._last_s = now_s
            self.say(progress=min(done_s / max(total_s, 1e-3), 1.0), text=text)

    def write(self, text: str) -> int:
        """Convert printed text to notes."""
        *lines, self._rest = (self._rest + text).split("\n")
        for line in lines:
            if line.strip():
                self.note(line.rstrip())
        return len(text)

    def flush(self) -> None:
        """Do nothing: only an incomplete line is buffered."""


def main(
    *,
    cell: Annotated[Path, typer.Option(help="The cell file.")],
    poses: Annotated[int, typer.Option(min=6, max=40, help="Poses for the fit.")] = 10,
    verify_poses: Annotated[
        int, typer.Option(min=1, max=20, help="Further poses for verification.")
    ] = 4,
    speed: Annotated[float, typer.Option(min=1.0, max=1000.0, help="[mm/s]")] = 1e3 * SPEED_M_S,
) -> None:
    """Identify payload and sensor bias, verify them, write the cell's calibration."""
    said = JsonLineOutput(sys.stdout)
    with _as_notes(said):
        try:
            code = _run(said, cell, (poses, verify_poses), speed / 1e3)
        except ForcemeshError as error:
            said.say(error=str(error))
            code = USAGE
    said.say(end=code)
    raise typer.Exit(code)


def _run(said: JsonLineOutput, path: Path, counts: tuple[int, int], speed_m_s: float) -> int:
    cell = load_cell(path, {"calibration": None})
    job = Job(cell, places_of(cell, path, None), VerificationBounds(), use=True)
    pace = WizardTiming(min(speed_m_s, cell.limits.speed_m_s), DWELL_S)
    wish = by_arm.ArmOptions(PlanOptions(*counts, radians(TURN_DEG)), pace, yes=True)
    with open_bus(cell, CLIENT, patience_s=CONNECT_PATIENCE_S) as bus:
        refuse_loaded_tool(bus, cell)
        plan = by_arm.planned(cell, bus, wish)
        said.say(plan=by_arm.explained(cell, plan, pace))
        if sys.stdin.readline().strip() != "go":
            said.note("nothing was moved")
            return NOT_WELL
        wizard, ended = by_arm.measure(cell, bus, plan, pace, teller=said)
        return by_arm.finish(
            job,
            wizard,
            ended,
            lambda: _conclude(said, job, by_arm.evidence(job, wizard), bus),
            tellers=lambda: contextlib.nullcontext(said),
        )


def _conclude(said: JsonLineOutput, job: Job, evidence: Evidence, bus: Bus) -> int:
    """Show the result and the residual at each pose, then conclude as the command does."""
    found = findings_of(job.cell, evidence, job.bounds)
    fresh = found.verify_left
    said.say(
        left={
            "fit_N": _rounded(found.fit_left.force_N),
            "fresh_N": [] if fresh is None else _rounded(fresh.force_N),
            "limit_N": job.bounds.force_N,
            "verdict": found.verdict.text,
            "found": found_parameters(found.report),
        }
    )
    for warning in found.report["warnings"]:
        said.note(f"⚠ {warning}")
    return settle(job, found, bus)


def _rounded(lengths: np.ndarray[Any, Any]) -> list[float]:
    return [round(float(length), 4) for length in lengths]


@contextlib.contextmanager
def _as_notes(said: JsonLineOutput) -> Iterator[None]:
    """Convert everything that the wizard's functions print to notes."""
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        yield


if __name__ == "__main__":
    typer.run(main)

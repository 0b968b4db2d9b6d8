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
from math import radians
from pathlib import Path
from typing import IO, Annotated, Any

import numpy as np
from typer import Exit, Option, run

from cli.calibration import by_arm
from cli.calibration.drive import refuse_loaded_tool
from cli.calibration.finish import Job, store_result
from cli.calibration.output_files import output_files
from cli.context import CONNECT_PATIENCE_S, NOT_WELL, USAGE
from cli.payload_tables import found_parameters
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.errors import ForcemeshError
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
        self._partial_line = ""
        self._last_s = 0.0

    def write_object(self, **fields: Any) -> None:
        """Write one object."""
        self._out.write(json.dumps(fields) + "\n")
        self._out.flush()

    def note(self, text: str) -> None:
        """Write one line that stays visible."""
        self.write_object(note=text)

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Write the progress, at most some times a second."""
        now_s = time.monotonic()
        if now_s - self._last_s >= EACH_S:
            self._last_s = now_s
            self.write_object(progress=min(done_s / max(total_s, 1e-3), 1.0), text=text)

    def write(self, text: str) -> int:
        """Convert printed text to notes."""
        *lines, self._partial_line = (self._partial_line + text).split("\n")
        for line in lines:
            if line.strip():
                self.note(line.rstrip())
        return len(text)

    def flush(self) -> None:
        """Do nothing: only an incomplete line is buffered."""


def main(
    *,
    cell: Annotated[Path, Option(help="The cell file.")],
    poses: Annotated[int, Option(min=6, max=40, help="Poses for the fit.")] = 10,
    verify_poses: Annotated[int, Option(min=1, max=20, help="Further poses for verification.")] = 4,
    speed: Annotated[float, Option(min=1.0, max=1000.0, help="[mm/s]")] = 1e3 * SPEED_M_S,
) -> None:
    """Identify payload and sensor bias, verify them, write the cell's calibration."""
    output = JsonLineOutput(sys.stdout)
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            code = _run(output, cell, (poses, verify_poses), speed / 1e3)
        except ForcemeshError as error:
            output.write_object(error=str(error))
            code = USAGE
    output.write_object(end=code)
    raise Exit(code)


def _run(output: JsonLineOutput, path: Path, counts: tuple[int, int], speed_m_s: float) -> int:
    cell = load_cell(path, {"calibration": None})
    job = Job(cell, output_files(cell, path, None), VerificationBounds(), use=True)
    speed_m_s = min(speed_m_s, cell.limits.speed_m_s)
    plan_options = PlanOptions(*counts, radians(TURN_DEG), speed_m_s, DWELL_S)
    options = by_arm.ArmOptions(plan_options, yes=True)
    with ConfiguredCell(cell, patience_s=CONNECT_PATIENCE_S) as client:
        refuse_loaded_tool(client)
        plan = by_arm.calibration_plan(client, options)
        output.write_object(plan=by_arm.motion_description(cell, plan))
        if sys.stdin.readline().strip() != "go":
            output.note("nothing was moved")
            return NOT_WELL
        wizard, ended = by_arm.drive(client, plan, output, returns=False)
        return by_arm.finish(
            job,
            wizard,
            ended,
            lambda: _conclude(output, job, by_arm.evidence(job, wizard), client),
            open_output=lambda: contextlib.nullcontext(output),
        )


def _conclude(output: JsonLineOutput, job: Job, evidence: Evidence, client: ConfiguredCell) -> int:
    """Show the result and the residual at each pose, then conclude as the command does."""
    found = findings_of(job.cell, evidence, job.bounds)
    verification = found.verify_residual
    output.write_object(
        left={
            "fit_N": _rounded(found.evidence.fit.residual.force_N),
            "fresh_N": [] if verification is None else _rounded(verification.force_N),
            "limit_N": job.bounds.force_N,
            "verdict": found.verdict.text,
            "found": found_parameters(found.report),
        }
    )
    for warning in found.report["warnings"]:
        output.note(f"⚠ {warning}")
    return store_result(job, found, client)


def _rounded(lengths: np.ndarray[Any, Any]) -> list[float]:
    return [round(float(length), 4) for length in lengths]


if __name__ == "__main__":
    run(main)

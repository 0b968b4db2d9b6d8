"""No calibration is made from a sensor that is installed another way than the cell file says.

A fit would hide it: some wrong axes have a payload that explains them, and the tool would press the
harder the more it should give way.
"""

from collections.abc import Sequence

import typer

from cli.calibration.finish import Job
from common.config.cell import Cell
from identification.dwells import Dwell, of_purpose, recording_of
from identification.errors import CalibrationError
from identification.installation.check import judge_recording
from identification.installation.terms import Belief
from identification.recording import Recording, WrenchAxes


def refuse_wrong_axes(job: Job, dwells: Sequence[Dwell]) -> None:
    """Do so with the poses that a calibration is to be fitted to."""
    recording = recording_of(of_purpose(dwells, "fit"), job.places.readings)
    refuse_wrong(job.cell, recording, "sensor", force=job.force)


def refuse_wrong(
    cell: Cell, recording: Recording, axes: WrenchAxes | None, *, force: bool = False
) -> None:
    """Raise CalibrationError with what looks wrong and what to write; with force, only say it.

    Args:
        cell: What is believed.
        recording: Static readings in many attitudes.
        axes: In which the wrench was recorded; None: find out.
        force: Go on all the same.
    """
    belief = Belief.of(cell)
    found = judge_recording(recording, axes, belief)[1]
    if belief.mass_kg is None and "mass_kg" in found.evidence:
        typer.echo(
            f"the tool reads {found.evidence['mass_kg']:.3g} kg, and the cell file knows none: is "
            "that so? A wrong unit of force (kgf, pounds) shows here alone",
            err=True,
        )
    if found.complaint is None:
        return
    if force:
        typer.echo(f"warning: {found.complaint}", err=True)
        return
    raise CalibrationError(
        f"{found.complaint}; no calibration is made of that (`forcemesh check axes` says more, "
        "--force makes one all the same)"
    )

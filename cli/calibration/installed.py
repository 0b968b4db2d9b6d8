"""Installation check before a calibration: axes, signs and units must match the cell file.

A fit could hide wrong axes, as some of them are explained by a payload; the force loop would then
have positive feedback.
"""

from collections.abc import Sequence

import typer

from cli.calibration.finish import Job
from common.config.cell import CellConfig
from identification.dwells import Dwell, dwells_of_purpose, recording_of
from identification.errors import CalibrationError
from identification.installation.check import judge_recording
from identification.installation.terms import ExpectedInstallation
from identification.recording import WrenchAxes, WrenchRecording


def refuse_wrong_axes(job: Job, dwells: Sequence[Dwell]) -> None:
    """Raise CalibrationError when the dwells of the fit contradict the installation."""
    recording = recording_of(dwells_of_purpose(dwells, "fit"), job.files.readings)
    refuse_wrong_installation(job.cell, recording, "sensor", force=job.force)


def refuse_wrong_installation(
    cell: CellConfig, recording: WrenchRecording, axes: WrenchAxes | None, *, force: bool = False
) -> None:
    """Raise CalibrationError with the finding and its remedy; with force, print a warning.

    Args:
        cell: Expected installation.
        recording: Static readings in many attitudes.
        axes: Axes in which the wrench was recorded; None: detect them.
        force: Continue in spite of a finding.
    """
    expected = ExpectedInstallation.of(cell)
    found = judge_recording(recording, axes, expected)[1]
    if expected.mass_kg is None and "mass_kg" in found.evidence:
        typer.echo(
            f"the measured tool mass is {found.evidence['mass_kg']:.3g} kg, the cell file has "
            "none: check it. A wrong unit of force (kgf, pounds) is detectable only here",
            err=True,
        )
    if found.rejection_reason is None:
        return
    if force:
        typer.echo(f"warning: {found.rejection_reason}", err=True)
        return
    raise CalibrationError(
        f"{found.rejection_reason}; no calibration is made (`forcemesh check axes` shows more, "
        "--force makes one nevertheless)"
    )

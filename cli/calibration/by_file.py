"""Calibration from a recording: no motion, the cell need not be up."""

from pathlib import Path

import typer

from cli.calibration.finish import Job, conclude
from cli.calibration.installed import refuse_wrong_installation
from common.bus.cell_bus import open_bus
from forcemesh.errors import BusError
from forcemesh.topics import CLIENT
from identification.evidence import Evidence
from identification.identify import identify_recording
from identification.recording import Samples, WrenchAxes, read_recording
from identification.static_poses import sort_into_poses

SEND_PATIENCE_S = 0.5


def calibrate(job: Job, recording: Path, verification: Path | None, axes: WrenchAxes | None) -> int:
    """Fit a recording, verify by another one if given, write, send if the cell is up.

    Raises DataError when a recording cannot be used.
    """
    data = read_recording(recording)
    refuse_wrong_installation(job.cell, data, axes, force=job.force)
    chosen_axes, fit, reason = identify_recording(data, axes)
    if reason:
        typer.echo(reason, err=True)
    verify = None if verification is None else _pose_means(verification, chosen_axes)
    evidence = Evidence("recording", data, chosen_axes, fit, verify)
    try:
        with open_bus(job.cell, CLIENT, patience_s=SEND_PATIENCE_S) as bus:
            return conclude(job, evidence, bus)
    except BusError:
        return conclude(job, evidence, None)


def _pose_means(path: Path, axes: WrenchAxes) -> Samples:
    return sort_into_poses(read_recording(path).samples(axes)).means

"""A cell on the virtual clock with its recorder, and recordings of it."""

from pathlib import Path
from typing import Any

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.records import Record
from forcemesh.requests import (
    ArmRequest,
    Empty,
    ForceStartRequest,
    GainsRequest,
    HoldRequest,
    MoveRequest,
    RecordRequest,
)
from forcemesh.topics import Request
from launch.virtual_cell import VirtualCell
from services.recorder.service import Recorder
from tests.fakes.bench import DEMO

READY_S = 1.5  # until the arm can be armed
Job = tuple[tuple[Request[Any], Record, float], ...]
PRESS = ForceStartRequest(mode="position", setpoint_N=15.0)
# Every kind of step of the arbiter and the regulator: request, message, time until the next one.
JOB: Job = (
    (topics.TARE, Empty(), 0.1),
    (topics.ARM, ArmRequest(), 0.1),
    (topics.MOVE, MoveRequest(kind="by", joint_rad=(0.01, 0.0, 0.0, 0.0, 0.0, 0.0)), 0.6),
    (topics.FORCE_START, PRESS, 1.0),
    (topics.GAINS, GainsRequest(preset="gentle"), 0.2),
    (topics.FORCE_STOP, Empty(), 0.1),
    (topics.HOLD, HoldRequest(reason="<enough>"), 0.1),
    (topics.CLEAR, Empty(), 0.3),
    (topics.ARM, ArmRequest(), 0.1),
)


class RecordedCell:
    """The demo cell with its recorder, ready to be armed."""

    def __init__(self, folder: Path) -> None:
        """Start; recordings are written to a folder."""
        settings = {"recorder.folder": str(folder), "recorder.least_free_GB": 0.0}
        self.folder, self.world = folder, VirtualCell(load_cell(DEMO, settings))
        bus = self.world._bus("recorder")
        self.world._add("recorder", Recorder(bus, self.world.cell), bus)
        self.world.advance(READY_S)

    def play(self, job: Job) -> None:
        """Send the requests of a job, each with the time until the next one."""
        for request, message, then_s in job:
            reply = self.world.client.ask(request, message)
            assert reply.accepted, f"{request.key}: {reply.text}"
            self.world.advance(then_s)

    def record(self, label: str, *, past: bool = False) -> None:
        """Start a recording, with what is in memory or from now on."""
        self.play(((topics.RECORD_START, RecordRequest(label=label, past=past), 0.0),))

    def stop(self, label: str) -> Path:
        """End the recording; return its file."""
        self.play(((topics.RECORD_STOP, Empty(), 0.0),))
        (path,) = self.folder.glob(f"*-{label}-01.mcap")
        return path


def recorded(folder: Path, job: Job = JOB, before: Job | None = None) -> Path:
    """Return a recording of a job: from the start of the cell, or two seconds after another job."""
    cell = RecordedCell(folder)
    cell.play(before or ())
    cell.record("job", past=before is None)
    cell.world.advance(0.0 if before is None else 2.0)
    cell.play(job)
    return cell.stop("job")

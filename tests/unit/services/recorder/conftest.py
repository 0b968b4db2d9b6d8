"""The recorder on a bus in memory and a clock of the test, and its files."""

from pathlib import Path
from typing import Any

from common.config.cell import CellConfig
from common.config.load import cell_from_tree
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.messages import ArbiterState, ArbiterStatus, RecorderStatus
from forcemesh.requests import Empty, RecordRequest, Reply
from services.recorder.service import STEPS_HZ, Recorder
from tests.fakes.bench import CELL, Bench

WALL_NS = 1_800_000_000 * NS_PER_S
TRIP: dict[str, Any] = {"code": "force", "rule": 408, "text": "61 N, the limit is 60 N"}


def cell_with(folder: Path, **section: Any) -> CellConfig:
    """Return the demo's cell that records into a folder."""
    tree = CELL.model_dump()
    tree["recorder"] |= {"folder": str(folder), "least_free_GB": 0.0, **section}
    return cell_from_tree(tree, "test")


class RecorderBench(Bench):
    """Publishes messages, advances the clock, sends requests to the recorder."""

    def __init__(self, folder: Path, *, name: str = "demo", **section: Any) -> None:
        """Start a recorder that records into a folder."""
        self.folder, self.wall_zero_ns = folder, WALL_NS
        cell = cell_with(folder, **section).model_copy(update={"cell": name})
        super().__init__("recorder", self._recorder, cell, step_s=1.0 / STEPS_HZ)
        self.transport.advance = lambda *_: self.recorder.step(self.clock.now_ns())
        self.watch(topics.RECORDER_STATUS)

    def _recorder(self, bus: Any, cell: CellConfig) -> Recorder:
        self.recorder = Recorder(bus, cell, wall_ns=lambda: self.wall_zero_ns + self.clock.now_ns())
        return self.recorder

    def pass_s(self, duration_s: float) -> None:
        """Advance by a time while the wrench is published, once in every step."""
        for _ in range(round(duration_s / self.step_s)):
            self.put(topics.WRENCH, topics.WRENCH.message())
            self.step()

    def trip(self, state: ArbiterState = "HOLDING", code: str = "force") -> None:
        """Trip an arm that was in motion."""
        self.put(topics.ARBITER_STATUS, ArbiterStatus(state="ACTIVE"))
        self.pass_s(0.1)
        status = ArbiterStatus.from_dict({"state": state, "trips": (TRIP | {"code": code},)})
        self.put(topics.ARBITER_STATUS, status)
        self.pass_s(0.1)

    def start(self, **options: Any) -> Reply:
        """Send the request to record."""
        return self.ask(topics.RECORD_START, RecordRequest(**options))

    def stop(self) -> Reply:
        """Send the request to end the recording."""
        return self.ask(topics.RECORD_STOP, Empty())

    def status(self) -> RecorderStatus:
        """Return the recorder's status."""
        message: RecorderStatus = self.newest(topics.RECORDER_STATUS)
        return message

    def files(self) -> list[Path]:
        """Return the recordings in its folder."""
        return sorted(self.folder.glob("*.mcap"))

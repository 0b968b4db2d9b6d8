"""Messages of a topic in a CSV file: columns, gaps, ends, wrong input."""

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.recording_tables import Written, write_csv
from common.bus.memory_bus import MemoryTransport
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.errors import LostError
from forcemesh.messages import Message, WrenchAtTcp
from forcemesh.topics import Topic
from tests.fakes.bench import DEMO

CELL = load_cell(DEMO)


WRENCH: Topic[Any] = topics.WRENCH


class PublishingCell:
    """A cell whose writer publishes the next message whenever the reader waits."""

    def __init__(self, topic: Topic[Any], messages: list[Message]) -> None:
        self.clock, transport = ManualClock(), MemoryTransport()
        buses = [Bus(r, CELL.cell, transport, CELL, self.clock) for r in (topic.writer, "client")]
        self._messages, self._put = messages, buses[0].publisher(topic).put
        self.session = SimpleNamespace(bus=buses[1], clock=self)

    def now_ns(self) -> int:
        """Advance the clock by 4 ms, publish the next message, and return the time."""
        self.clock.sleep_s(0.004)
        if self._messages:
            self._put(self._messages.pop(0))
        return self.clock.now_ns()


def written_by(
    topic: Topic[Any], messages: list[Message], path: Path, **end: Any
) -> tuple[Written, list[dict[str, str]]]:
    """Write until the end; return the counts and the rows."""
    cell: Any = PublishingCell(topic, messages)
    options = {"seconds": None, "count": None, "silence_s": 1.0, **end}
    written = write_csv(cell, topic, path, **options)
    with path.open(newline="", encoding="utf-8") as stream:
        return written, list(csv.DictReader(stream))


FORCES = st.tuples(*[st.floats(-1e3, 1e3)] * 3)


@given(st.lists(FORCES, min_size=1, max_size=20))
def test_every_message_is_a_row_and_every_number_is_exact(
    tmp_path_factory: pytest.TempPathFactory, forces: list[Any]
) -> None:
    """The columns' names contain units, as in an export."""
    path = tmp_path_factory.mktemp("csv") / "wrench.csv"
    messages: list[Message] = [WrenchAtTcp(force_N=force) for force in forces]
    written, rows = written_by(topics.WRENCH, messages, path, count=len(forces))
    assert written == (len(forces), 0)
    names = [f"force_N.{axis}" for axis in "xyz"]
    assert [tuple(float(row[name]) for name in names) for row in rows] == forces
    times_s = [float(row["time_s"]) for row in rows]
    assert times_s[0] == 0.0
    assert times_s == sorted(times_s)


def test_writing_ends_after_the_time_or_with_an_error_in_silence(tmp_path: Path) -> None:
    """The earlier messages are in the file."""
    wrench = WrenchAtTcp(force_N=(1.0, 2.0, 3.0))
    written, rows = written_by(topics.WRENCH, [wrench] * 1000, tmp_path / "a.csv", seconds=0.5)
    assert 20 < written.messages == len(rows) < 200
    with pytest.raises(LostError, match="nothing on wrench for 1 s"):
        written_by(topics.WRENCH, [wrench] * 3, tmp_path / "b.csv")
    assert len((tmp_path / "b.csv").read_text().splitlines()) == 4

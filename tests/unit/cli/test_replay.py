"""Verbs on a recording of a whole virtual cell: replay, export, report, and refusals."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet

from common.bus.memory_bus import MemoryTransport
from forcemesh import topics
from forcemesh.clock import ManualClock
from forcemesh.codec import decode
from forcemesh.requests import ArmRequest, HoldRequest
from services.recorder.reading import RecordedBytes, RecordedFile, play
from tests.fakes.recorded_cell import PRESS, READY_S, RecordedCell
from tests.fakes.verb_calls import run

MESSAGES: dict[str, Any] = {topic.key: topic.message for topic in topics.TOPICS}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a cell that is armed, presses briefly and is held."""
    cell = RecordedCell(tmp_path_factory.mktemp("recordings"))
    cell.world.advance(READY_S)
    cell.record("press")
    cell.play((
        (topics.ARM, ArmRequest(), 0.1), (topics.FORCE_START, PRESS, 1.4),
        (topics.HOLD, HoldRequest(reason="<enough>"), 0.2),
    ))  # fmt: skip
    return cell.stop("press")


class RecordingTransport(MemoryTransport):
    """A bus that keeps every message published on it, in order."""

    def __init__(self) -> None:
        super().__init__()
        self.published: list[tuple[str, bytes]] = []

    def publish(self, key: str, _qos: Any) -> Any:
        """Return a function that keeps the bytes with their key."""
        return lambda data: self.published.append((key, data))


def played(messages: list[RecordedBytes], name: str, **options: float) -> tuple[Any, int]:
    """Play under a cell's name; return what was published and the duration [ns]."""
    transport, clock = RecordingTransport(), ManualClock()
    began_ns = clock.now_ns()
    assert play(messages, transport, name, clock=clock, **options) == len(messages)
    return transport.published, clock.now_ns() - began_ns


def test_a_replay_publishes_the_same_bytes_in_the_same_time(recording: Path) -> None:
    """As another cell only the topic of each message changes; a speed divides the distances."""
    recorded = list(RecordedFile(recording).raw_messages())
    assert len(recorded) > 2000
    published, took_ns = played(recorded, "demo")
    assert published == [(f"demo/{each.topic}", each.data) for each in recorded]
    assert took_ns == recorded[-1].at_ns - recorded[0].at_ns
    published, took_ns = played(recorded[:200], "other", speed=4.0)
    assert took_ns == pytest.approx((recorded[199].at_ns - recorded[0].at_ns) / 4.0, abs=1000)
    for each, (key, data) in zip(recorded, published, strict=False):
        header, message = decode(data, MESSAGES[each.topic], f"other/{each.topic}")
        then, before = decode(each.data, MESSAGES[each.topic], f"demo/{each.topic}")
        assert key == header.topic
        assert (header.replaced(topic=then.topic), message) == (then, before)


def test_csv_and_parquet_have_every_number_with_its_unit(recording: Path, tmp_path: Path) -> None:
    """A file for each topic, as many rows as messages, time in seconds since the beginning."""
    done = run("export", recording, "-o", tmp_path)
    assert done.exit_code == 0
    with (tmp_path / "wrench.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    force_N = [each.fields["force_N"]["z"] for each in RecordedFile(recording).messages("wrench")]
    assert [float(row["force_N.z"]) for row in rows] == force_N
    assert 0.0 <= float(rows[0]["time_s"]) < float(rows[-1]["time_s"]) < 3.0
    assert f"wrench.csv: {len(rows)} rows" in done.stdout
    assert (tmp_path / "arbiter-status.csv").exists()
    words = ("export", recording, "--only", "wrench", "--parquet", "-o", tmp_path / "one")
    assert run(*words).exit_code == 0
    assert [path.name for path in (tmp_path / "one").iterdir()] == ["wrench.parquet"]
    table = parquet.read_table(tmp_path / "one" / "wrench.parquet").to_pydict()
    assert table["force_N.z"] == force_N


def test_lerobot_columns_hold_state_wrench_and_action(recording: Path, tmp_path: Path) -> None:
    """One row for each state of the robot, one episode, and a description of the columns."""
    assert run("export", recording, "--lerobot", "--parquet", "-o", tmp_path).exit_code == 0
    info = json.loads((tmp_path / "meta" / "info.json").read_text(encoding="utf-8"))
    assert info["fps"] == pytest.approx(250.0, rel=0.01)
    path = tmp_path / "data" / "chunk-000" / "episode_000000.parquet"
    table = parquet.read_table(path).to_pydict()
    for name, width in (("observation.state", 6), ("observation.wrench", 6), ("action", 7)):
        assert {len(row) for row in table[name]} == {width}
    assert table["frame_index"] == list(range(info["total_frames"]))
    assert max(row[2] for row in table["observation.wrench"]) > 5.0
    assert table["next.done"][-1]


def test_the_report_is_one_page_with_plots_stops_and_requests(
    recording: Path, tmp_path: Path
) -> None:
    """It has no network reference, typed texts are escaped, and the arm in 3D is embedded."""
    page = tmp_path / "report.html"
    done = run("report", recording, "-o", page)
    assert (done.exit_code, "1 stops" in done.stdout) == (0, True)
    assert "srcdoc=" in page.read_text(encoding="utf-8")
    assert run("report", recording, "-o", page, "--no-3d").exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml;base64,") == text.count("src=") == 5
    for part in ("HOLDING · hold (501)", "&lt;enough&gt;", "Remedy: ", "<td>force/start</td>"):
        assert part in text
    assert "@import" not in text
    assert 'href="http' not in text


def test_a_truncated_recording_is_shown_up_to_its_end(recording: Path, tmp_path: Path) -> None:
    """Report and export state that the recording is truncated."""
    part = tmp_path / "part.mcap"
    part.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    done = run("export", part, "--only", "wrench")
    assert (done.exit_code, "is truncated" in done.stderr) == (0, True)
    assert run("report", part, "--no-3d").exit_code == 0
    assert "truncated" in part.with_suffix(".html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("export", "--only", "wrnch"), "did you mean wrench?"),
        (("export", "-o", "/proc/none"), "/proc/none: cannot be written"),
        (("replay", "--to-service", "arbiter,hub"), "--to-service hub: it must be one of"),
        (("replay", "--as", "Not A Name"), "--as: cell: must be at most 31 lower-case"),
        (("replay", "--onto", "nothing.yaml"), "no such file"),
    ],
)
def test_wrong_input_is_one_sentence(recording: Path, words: tuple[str, ...], text: str) -> None:
    """The sentence gives the cause."""
    done = run(words[0], recording, *words[1:])
    assert done.exit_code == 2
    assert text in " ".join(done.stderr.replace("│", " ").split())

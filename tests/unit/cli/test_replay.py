"""Verbs on a recording of a whole virtual cell: replay, export, report, and refusals."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from cli.__main__ import app
from common.bus.memory_bus import MemoryTransport
from common.config.load import load_cell
from common.runtime.service import HealthReporter, Runner
from forcemesh import topics
from forcemesh.clock import ManualClock
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest, RecordRequest
from launch.virtual_cell import VirtualCell
from services.recorder.reading import RecordedFile, play
from services.recorder.service import Recorder
from tests.fakes.bench import DEMO


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A recording of a cell that is armed, presses briefly and is held."""
    folder = tmp_path_factory.mktemp("recordings")
    settings = {"recorder.folder": str(folder), "recorder.least_free_GB": 0.0}
    world = VirtualCell(load_cell(DEMO, settings))
    bus = world._bus("recorder")
    recorder = Recorder(bus, world.cell)
    world.runners["recorder"] = Runner(recorder, [HealthReporter(bus, world.cell)], world.clock)
    world.advance(1.5)
    steps: tuple[tuple[Any, Any, float], ...] = (
        (topics.RECORD_START, RecordRequest(label="press"), 0.0),
        (topics.ARM, ArmRequest(), 0.1),
        (topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=15.0), 1.4),
        (topics.HOLD, HoldRequest(reason="<enough>"), 0.2),
        (topics.RECORD_STOP, Empty(), 0.0),
    )
    for request, message, then_s in steps:
        assert world.client.ask(request, message).accepted, request.key
        world.advance(then_s)
    (path,) = folder.glob("*.mcap")
    yield path
    recorder.close()


def run(*words: object) -> tuple[int, str, str]:
    """Run the command line; return exit code, standard output and error."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.stdout, result.stderr


def rows_of(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


class RecordingTransport(MemoryTransport):
    """A bus that keeps every message published on it, in order."""

    def __init__(self) -> None:
        super().__init__()
        self.published: list[tuple[str, bytes]] = []

    def publish(self, key: str, _qos: Any) -> Any:
        """Return a function that keeps the bytes with their key."""
        return lambda data: self.published.append((key, data))


def test_a_replay_publishes_the_same_bytes_in_the_same_time(recording: Path) -> None:
    """On a virtual clock: every message, in order, under the cell's name, in the same duration."""
    recorded = list(RecordedFile(recording).raw_messages())
    transport, clock = RecordingTransport(), ManualClock()
    began_ns = clock.now_ns()
    count = play(recorded, transport, "demo", clock=clock)
    assert count == len(recorded) > 2000
    assert transport.published == [(f"demo/{each.topic}", each.data) for each in recorded]
    assert clock.now_ns() - began_ns == recorded[-1].at_ns - recorded[0].at_ns


def test_csv_has_a_file_for_each_topic_and_units_in_its_columns(
    recording: Path, tmp_path: Path
) -> None:
    """As many rows as messages, time in seconds since the beginning."""
    code, out, _ = run("export", recording, "-o", tmp_path)
    assert code == 0
    rows = rows_of(tmp_path / "wrench.csv")
    messages = list(RecordedFile(recording).messages("wrench"))
    assert len(rows) == len(messages)
    assert float(rows[7]["force_N.z"]) == messages[7].fields["force_N"]["z"]
    assert 0.0 <= float(rows[0]["time_s"]) < float(rows[-1]["time_s"]) < 3.0
    assert f"wrench.csv: {len(rows)} rows" in out
    assert (tmp_path / "arbiter-status.csv").exists()


def test_parquet_holds_the_same_numbers(recording: Path, tmp_path: Path) -> None:
    """Read by pyarrow, the columns are those of the CSV, and typed; of the named topic alone."""
    assert run("export", recording, "--only", "wrench", "--parquet", "-o", tmp_path)[0] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["wrench.parquet"]
    table = parquet.read_table(tmp_path / "wrench.parquet").to_pydict()
    messages = list(RecordedFile(recording).messages("wrench"))
    assert table["force_N.z"] == [each.fields["force_N"]["z"] for each in messages]
    assert str(table["valid"][0]) == "True"


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_lerobot_columns_hold_state_wrench_and_action(
    recording: Path, tmp_path: Path, suffix: str
) -> None:
    """One row for each state of the robot, one episode, and a description of the columns."""
    assert run("export", recording, "--lerobot", f"--{suffix}", "-o", tmp_path)[0] == 0
    path = tmp_path / "data" / "chunk-000" / f"episode_000000.{suffix}"
    info = json.loads((tmp_path / "meta" / "info.json").read_text(encoding="utf-8"))
    assert info["fps"] == pytest.approx(250.0, rel=0.01)
    if suffix == "csv":
        rows = rows_of(path)
        names = {"observation.state.5", "observation.wrench.5", "action.6", "frame_index"}
        assert names <= set(rows[0])
        return
    table = parquet.read_table(path).to_pydict()
    assert {len(row) for row in table["observation.state"]} == {6}
    assert {len(row) for row in table["observation.wrench"]} == {6}
    assert {len(row) for row in table["action"]} == {7}
    assert table["frame_index"] == list(range(info["total_frames"]))
    assert max(row[2] for row in table["observation.wrench"]) > 5.0
    assert table["next.done"][-1]


def test_the_report_is_one_page_with_plots_stops_and_remedies(
    recording: Path, tmp_path: Path
) -> None:
    """It has no network reference, typed texts are escaped, and the arm in 3D is embedded."""
    page = tmp_path / "report.html"
    code, out, _ = run("report", recording, "-o", page)
    text = page.read_text(encoding="utf-8")
    assert code == 0
    assert "1 stops" in out
    assert "<iframe" in text
    assert "srcdoc=" in text
    assert len(text) > 500_000
    assert run("report", recording, "-o", page, "--no-3d")[0] == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml;base64,") == 5
    assert "HOLDING · hold (501)" in text
    assert "&lt;enough&gt;" in text
    assert "Remedy: arm again when the path is clear" in text
    assert text.count("src=") == 5
    assert "@import" not in text
    assert 'href="http' not in text


def test_a_truncated_recording_is_shown_up_to_its_end(recording: Path, tmp_path: Path) -> None:
    """Report and export state that the recording is truncated."""
    part = tmp_path / "part.mcap"
    part.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    code, _, err = run("export", part, "--only", "wrench")
    assert code == 0
    assert "is truncated" in err
    assert run("report", part, "--no-3d")[0] == 0
    assert "truncated" in part.with_suffix(".html").read_text(encoding="utf-8")


WRONG = [
    (("export", "{}", "--only", "wrnch"), 2, "did you mean wrench?"),
    (("export", "{}", "-o", "/proc/none"), 2, "/proc/none: cannot be written"),
    (("report", "{}", "--no-3d", "-o", "/proc/none"), 2, "/proc/none: cannot be written"),
    (("replay", "{}", "--only", "wrnch"), 2, "did you mean wrench?"),
    (("replay", "{}", "--to-service", "robot"), 2, "must be one of wrench, regulator, arbiter"),
    (("replay", "{}", "--to-service", "arbiter,hub"), 2, "--to-service hub: it must be one of"),
    (("replay", "{}", "--as", "Not A Name"), 2, "--as: cell: must be at most 31 lower-case"),
    (("replay", "{}", "--onto", "nothing.yaml"), 2, "no such file"),
]


@pytest.mark.parametrize(("words", "code", "text"), WRONG)
def test_wrong_input_is_one_sentence(
    recording: Path, words: tuple[str, ...], code: int, text: str
) -> None:
    """The sentence gives the cause, without a traceback."""
    found, _, err = run(*(word.format(recording) for word in words))
    assert found == code
    assert text in " ".join(err.replace("│", " ").split())
    assert "Traceback" not in err

"""Verbs on a recording of a virtual cell: replay, export, report, and its services again."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet

from cli.replay_differences import Differences, compared
from cli.replay_parts import recorded_part
from cli.replay_service import replayed
from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.runtime.service import HealthReporter, Runner
from control.gains import scaled_gains
from forcemesh import topics
from forcemesh.clock import ManualClock
from forcemesh.codec import decode
from forcemesh.errors import DataError
from forcemesh.requests import ArmRequest, Empty, HoldRequest
from forcemesh.topics import SERVED
from services.arbiter.service import ArbiterService
from services.recorder.reading import RecordedBytes, RecordedFile, play
from services.regulator import period
from tests.fakes.recorded_cell import PRESS, Job, RecordedCell, recorded
from tests.fakes.verb_calls import run

MESSAGES: dict[str, Any] = {topic.key: topic.message for topic in topics.TOPICS}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a cell that is armed, presses briefly and is held."""
    cell = RecordedCell(tmp_path_factory.mktemp("recordings"))
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


def played(messages: list[RecordedBytes], name: str, **options: Any) -> tuple[Any, int]:
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
    for part in (
        "HOLDING · hold (501)",
        "&lt;enough&gt;",
        "Remedy: ",
        "<td>force/start</td>",
        ">impact<",
    ):
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


ARM: Job = ((topics.ARM, ArmRequest(), 0.3),)
START: Job = ((topics.FORCE_START, PRESS, 0.3),)
# Free of contact at its end: what the monitors of the arbiter remember is that of a new process.
HOLD: Job = ((topics.HOLD, HoldRequest(reason="before"), 0.2), (topics.CLEAR, Empty(), 0.2))
COUPLED = ("regulator", "arbiter")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording from the start of the cell: tare, arm, move, press, gains, stop, hold, clear."""
    return recorded(tmp_path_factory.mktemp("whole"))


@pytest.fixture(scope="module")
def later(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of a cell that has been armed before."""
    return recorded(tmp_path_factory.mktemp("later"), before=(*ARM, *HOLD))


def read(path: Path) -> tuple[list[RecordedBytes], CellConfig]:
    """Return the messages of a recording, and its cell."""
    recording = RecordedFile(path)
    assert recording.cell is not None
    return list(recording.raw_messages()), recording.cell


def differences(messages: list[RecordedBytes], cell: CellConfig, *roles: str) -> list[Differences]:
    """Return how what roles publish in a replay differs from the recording."""
    parts = [recorded_part(messages, role) for role in roles]
    published = replayed(messages, parts, cell)
    return [compared(part, published[part.role], 0) for part in parts]


@pytest.mark.parametrize("role", ["cell", "arbiter,wrench"])
@pytest.mark.parametrize("from_start", [True, False])
def test_a_recorded_cell_is_replayed_byte_for_byte(
    whole: Path, later: Path, role: str, *, from_start: bool
) -> None:
    """Services alone and coupled, from the start of the cell and from a moment within it."""
    done = run("replay", whole if from_start else later, "--to-service", role)
    assert (done.exit_code, done.stderr) == (0, "")
    counts = re.findall(r"(\d+) recorded, (\d+) now: (\d+) equal byte for byte", done.stdout)
    assert len(counts) >= 4
    assert all(recorded == now == equal for recorded, now, equal in counts)
    assert int(counts[0][0]) > 300
    assert ("its start" in done.stdout) == from_start


def test_a_changed_gain_is_shown_and_ends_the_verb_with_an_error(
    whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Topic, time, field, recorded and present value of the first differences; exit code 1."""
    monkeypatch.setattr(period, "ramped_gains", lambda _, goal, __: scaled_gains(goal, 1.001))
    done = run("replay", whole, "--to-service", "cell")
    assert done.exit_code == 1
    assert "pose.position_m.2: differs by at most" in done.stdout
    first = r"first differences:\n +\d+\.\d{3} s \S+ pose\.\S+: recorded \S+, now \S+\n"
    assert re.search(first, done.stdout)
    assert re.search(r"robot/command pose\.\S+: recorded", done.stdout), "it is coupled"
    assert run("replay", whole, "--to-service", "wrench").exit_code == 0


def test_a_message_that_is_lost_or_cannot_be_decoded_is_a_difference(whole: Path) -> None:
    """Each request has an effect on what its service publishes; one message of its own too."""
    messages, cell = read(whole)
    keys = {SERVED["regulator"].key, SERVED["arbiter"].key}
    served = [each for each in messages if each.topic in keys]
    assert len(served) == 8
    for lost in served[::2]:
        others = [each for each in messages if each is not lost]
        assert any(found.count for found in differences(others, cell, *COUPLED))
    places = [i for i, each in enumerate(messages) if each.topic == "arbiter/status"]
    place = places[len(places) // 2]
    (found,) = differences([*messages[:place], *messages[place + 1 :]], cell, "arbiter")
    assert [(each.recorded, each.now) for each in found.found] == [("not published", "published")]
    messages[place] = messages[place]._replace(data=b"\xc1")
    (found,) = differences(messages, cell, "arbiter")
    assert [(each.topic, each.name) for each in found.found] == [("arbiter/status", "message")]


@pytest.mark.parametrize(
    ("role", "before", "text"),
    [
        ("regulator", (*ARM, *START), "a moment at which no force feedback runs"),
        ("arbiter", ARM, r"the arbiter is IDLE, 1\.5 s before the arm is armed"),
    ],
)
def test_a_recording_that_does_not_reach_back_far_enough_is_one_sentence(
    tmp_path: Path, role: str, before: Job, text: str
) -> None:
    """It names what the recording must contain, and how to record that."""
    path = recorded(tmp_path, (), before)
    with pytest.raises(DataError, match=f"does not reach back far enough for {role}: .*{text}"):
        recorded_part(read(path)[0], role)
    done = run("replay", path, "--to-service", role)
    assert (done.exit_code, done.stdout) == (2, "")
    assert "`forcemesh record start --past` includes the minutes in memory" in done.stderr


def test_what_was_requested_before_is_counted(tmp_path: Path) -> None:
    """By the health of the role, unknown without it; those in the recording are played."""
    messages, _ = read(recorded(tmp_path, (*ARM, *HOLD), (*ARM, *HOLD)))
    (note,) = recorded_part(messages, "arbiter").notes
    assert note.startswith("3 requests were served before this, or are not in the recording: ")
    assert recorded_part(messages, "regulator").notes == []
    silent = [each for each in messages if each.topic != "regulator/health"]
    (note,) = recorded_part(silent, "regulator").notes
    assert note == "its health is not in the recording: requests served before are unknown"
    old = Path(__file__).resolve().parents[2] / "corpus" / "recording-version-2.mcap"
    (note,) = recorded_part(list(RecordedFile(old).raw_messages()), "regulator").notes
    assert note == "recorded without requests: what they changed appears as a difference"


def test_a_process_that_was_restarted_is_replayed_until_then(tmp_path: Path) -> None:
    """What another process published is not compared with the first one."""
    cell = RecordedCell(tmp_path)
    cell.record("first", past=True)
    world: Any = cell.world
    world.kill("arbiter")
    bus = world._bus("arbiter")
    service = ArbiterService(bus, world.cell)
    world.runners["arbiter"] = Runner(service, [HealthReporter(bus, world.cell)], world.clock)
    world.advance(1.0)
    messages, config = read(cell.stop("first"))
    (note,) = recorded_part(messages, "arbiter").notes
    assert note == "only until its process was restarted 1.600 s later"
    assert [each.count for each in differences(messages, config, "arbiter")] == [0]

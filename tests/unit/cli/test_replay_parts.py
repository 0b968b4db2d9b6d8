"""Start of a service within a recording: where its state is known, and what is unknown of it."""

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.replay_differences import compared
from cli.replay_parts import (
    Recorded,
    _silent_steps,
    _step,
    recorded_part,
)
from cli.replay_service import replayed
from common.config.cell import CellConfig
from common.runtime.service import HealthReporter, Runner
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.errors import DataError
from forcemesh.requests import ArmRequest, Empty, HoldRequest
from services.arbiter.service import ArbiterService
from services.recorder.reading import RecordedBytes, RecordedFile
from tests.fakes.recorded_cell import PRESS, READY_S, Job, RecordedCell, recorded_later

HOLD: Job = ((topics.HOLD, HoldRequest(), 0.2), (topics.CLEAR, Empty(), 0.2))
ARM: Job = ((topics.ARM, ArmRequest(), 0.3),)
START: Job = ((topics.FORCE_START, PRESS, 0.3),)


def messages_of(path: Path) -> tuple[list[RecordedBytes], CellConfig]:
    """Return the messages of a recording, and its cell."""
    read = RecordedFile(path)
    assert read.cell is not None
    return list(read.raw_messages()), read.cell


@pytest.fixture(scope="module")
def at_rest(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[RecordedBytes], CellConfig]:
    """The messages of a recording in which nothing is requested, and its cell."""
    return messages_of(recorded_later(tmp_path_factory.mktemp("rest"), (), ()))


def differences(path: Path, role: str) -> int:
    """Return how many fields of a role differ in a replay."""
    messages, cell = messages_of(path)
    part = recorded_part(messages, role)
    return compared(part, replayed(messages, [part], cell)[role], messages[0].at_ns).count


def test_what_was_requested_before_is_counted(tmp_path: Path) -> None:
    """By the number in the health of the role; those in the recording are played.

    Without its health they are unknown; a recording of before they were published has a note.
    """
    path = recorded_later(tmp_path, (*ARM, *HOLD), (*ARM, *HOLD))
    messages, _ = messages_of(path)
    (note,) = recorded_part(messages, "arbiter").notes
    assert note.startswith("3 requests were served before this, or are not in the recording: ")
    assert recorded_part(messages, "regulator").notes == []
    lost = [each for each in messages if each.topic != "arbiter/requests"]
    assert recorded_part(lost, "arbiter").notes[0].startswith("6 requests were served before")
    silent = [each for each in messages if each.topic != "regulator/health"]
    (note,) = recorded_part(silent, "regulator").notes
    assert note == "its health is not in the recording: requests served before are unknown"
    old = Path(__file__).resolve().parents[2] / "corpus" / "recording-version-2.mcap"
    (note,) = recorded_part(list(RecordedFile(old).raw_messages()), "regulator").notes
    assert note == "recorded without requests: what they changed appears as a difference"


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
    path = recorded_later(tmp_path, before, ())
    with pytest.raises(DataError, match=f"does not reach back far enough for {role}: .*{text}"):
        recorded_part(messages_of(path)[0], role)
    result = CliRunner().invoke(app, ["replay", str(path), "--to-service", role])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(f"{path}: the recording does not reach back far enough")
    assert "`forcemesh record start --past` includes the minutes in memory" in result.stderr


def test_an_arm_that_is_armed_at_once_is_replayed_from_its_next_rest(tmp_path: Path) -> None:
    """A new arbiter would refuse to arm without a second of inputs."""
    cell = RecordedCell(tmp_path)
    cell.world.advance(READY_S)
    cell.record("soon")
    cell.world.advance(0.5)
    cell.play((*ARM, *HOLD))
    cell.world.advance(2.0)
    cell.play((*ARM, *HOLD))
    path = cell.stop("soon")
    part = recorded_part(messages_of(path)[0], "arbiter")
    assert part.state is not None
    assert part.state.as_dict()["lease"] == 1
    assert differences(path, "arbiter") == 0


def test_a_short_recording_or_one_without_the_service_has_nothing_to_compare(at_rest: Any) -> None:
    """Shorter than a service needs to settle."""
    messages, cell = at_rest
    others = [each for each in messages if each.topic != "regulator/target"]
    with pytest.raises(DataError, match="no regulator/target: regulator has nothing to compare"):
        recorded_part(others, "regulator")
    short = [each for each in messages if each.at_ns < messages[0].at_ns + NS_PER_S]
    part = recorded_part(short, "wrench")
    published = replayed(short, [part], cell)["wrench"]
    with pytest.raises(DataError, match=r"too short: the output of wrench is compared from 1\.5 s"):
        compared(part, published, 0)


def restart(cell: RecordedCell) -> None:
    """Start another arbiter in place of the present one."""
    world: Any = cell.world
    world.kill("arbiter")
    bus = world._bus("arbiter")
    service = ArbiterService(bus, world.cell)
    world.runners["arbiter"] = Runner(service, [HealthReporter(bus, world.cell)], world.clock)


def test_a_process_that_was_restarted_is_replayed_until_then(tmp_path: Path) -> None:
    """What another process published is not compared with the first one."""
    cell = RecordedCell(tmp_path)
    cell.world.advance(READY_S)
    cell.record("first", past=True)
    restart(cell)
    cell.world.advance(1.0)
    path = cell.stop("first")
    (note,) = recorded_part(messages_of(path)[0], "arbiter").notes
    assert note == "only until its process was restarted 1.600 s later"
    assert differences(path, "arbiter") == 0


def test_a_message_that_cannot_be_decoded_is_a_difference(at_rest: Any) -> None:
    """One of the output: the replay publishes it."""
    messages, cell = list(at_rest[0]), at_rest[1]
    place = next(
        i for i, each in enumerate(messages) if each.topic == "arbiter/status" and i > 2900
    )
    messages[place] = messages[place]._replace(data=b"\xc1")
    part = recorded_part(messages, "arbiter")
    found = compared(part, replayed(messages, [part], cell)["arbiter"], 0)
    assert [(each.topic, each.name) for each in found.found] == [("arbiter/status", "message")]


# --- when a step has read its inputs --------------------------------------------------------------

MS = 1_000_000


def message(topic: topics.Topic[Any], at_ms: float, sample: int) -> Recorded:
    """Return a message about a sensor sample."""
    of_sensor = topic is topics.SENSOR_WRENCH
    header = Header(
        seq=sample if of_sensor else 1,
        epoch=1,
        boot="virtual",
        stamp_ns=round(at_ms * MS),
        sensor_seq=None if of_sensor else sample,
    )
    return Recorded(topic.key, header.stamp_ns, b"", header, topic.message())


def silent_steps(outputs: list[Recorded], *samples_ms: float) -> list[tuple[float, float]]:
    """Return time and end of the steps without an output, for samples 0, 1, 2, ... at times."""
    samples = [message(topics.SENSOR_WRENCH, at_ms, n) for n, at_ms in enumerate(samples_ms)]
    steps = [_step(each, samples) for each in outputs]
    return [(s.at_ns / MS, s.until_ns / MS) for s in _silent_steps(steps, outputs, samples)]


def test_a_sample_that_no_output_names_was_filtered_without_one() -> None:
    """At its time, and requests until the next sample belong to that step.

    One during another step waits for its end, unless a newer one has replaced it by then.
    """
    outputs = [message(topics.WRENCH, 0.0, 0), message(topics.WRENCH, 4.0, 2)]
    steps = silent_steps(outputs, 0.0, 2.0, 4.0, 6.0)
    assert [at_ms for at_ms, _ in steps] == [2.0, 6.0]
    assert steps[0][1] == pytest.approx(4.0, abs=1e-5)
    late = [message(topics.WRENCH, 7.0, 0), message(topics.WRENCH, 9.0, 4)]
    assert [at_ms for at_ms, _ in silent_steps(late, 0.0, 2.0, 4.0, 6.0, 8.5)] == [7.0]


def test_a_command_that_was_published_late_is_replayed_with_the_inputs_that_it_had(
    at_rest: Any,
) -> None:
    """Its process was interrupted between reading and publishing, past the next target."""
    messages, cell = at_rest
    commands = [each for each in messages if each.topic == "robot/command"]
    late, following = commands[-60], commands[-59]
    moved = late._replace(at_ns=following.at_ns - 1)
    others = [each for each in messages if each is not late]
    changed = sorted([*others, moved], key=lambda each: each.at_ns)
    part = recorded_part(changed, "arbiter")
    assert sum(step.read_ns < step.at_ns for step in part.steps) == 0
    moved = late._replace(at_ns=following.at_ns + 1)
    later = following._replace(at_ns=following.at_ns + 2)
    others = [each for each in others if each is not following]
    changed = sorted([*others, moved, later], key=lambda each: each.at_ns)
    part = recorded_part(changed, "arbiter")
    assert sum(step.read_ns < step.at_ns for step in part.steps) == 1
    found = compared(part, replayed(changed, [part], cell)["arbiter"], 0)
    assert found.count == 0

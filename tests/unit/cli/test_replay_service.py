"""Replay of a recorded cell through its services: byte-equal, or the difference is reported."""

import re
from pathlib import Path
from typing import Any

import pytest

from cli.replay_differences import Differences, compared
from cli.replay_parts import recorded_part
from cli.replay_service import replayed
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.errors import DataError
from forcemesh.requests import ArmRequest, Empty, HoldRequest
from forcemesh.topics import SERVED
from services.arbiter.service import ArbiterService
from services.recorder.reading import RecordedBytes, RecordedFile
from services.regulator.gains import PiGains
from services.regulator.service import Regulator
from tests.fakes.recorded_cell import (
    PRESS,
    READY_S,
    Job,
    RecordedCell,
    recorded_from_start,
    recorded_later,
)
from tests.fakes.verb_calls import run

ARM: Job = ((topics.ARM, ArmRequest(), 0.3),)
START: Job = ((topics.FORCE_START, PRESS, 0.3),)
# Free of contact at its end: what the monitors of the arbiter remember is that of a new process.
HOLD: Job = ((topics.HOLD, HoldRequest(reason="before"), 0.2), (topics.CLEAR, Empty(), 0.2))
COUPLED = ("regulator", "arbiter")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording from the start of the cell: tare, arm, move, press, gains, stop, hold, clear."""
    return recorded_from_start(tmp_path_factory.mktemp("whole"))


@pytest.fixture(scope="module")
def later(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of a cell that has been armed before."""
    return recorded_later(tmp_path_factory.mktemp("later"), (*ARM, *HOLD))


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
    use_gains = Regulator._use_gains

    def stiffer(self: Regulator, gains: Any) -> None:
        use_gains(self, gains)
        more = tuple(1.001 * value for value in gains.force_i_m_per_Ns)
        self._pi_gains = PiGains.of(gains.replaced(force_i_m_per_Ns=more))

    monkeypatch.setattr(Regulator, "_use_gains", stiffer)
    done = run("replay", whole, "--to-service", "cell")
    assert done.exit_code == 1
    assert "pose.position_m.2: differs by at most" in done.stdout
    first = r"first differences:\n +\d+\.\d{3} s \S+ pose\.\S+: recorded \S+, now \S+\n"
    assert re.search(first, done.stdout)
    assert re.search(r"robot/command pose\.\S+: recorded", done.stdout), "it is coupled"
    assert run("replay", whole, "--to-service", "wrench").exit_code == 0


def test_a_message_that_is_lost_or_cannot_be_decoded_is_a_difference(whole: Path) -> None:
    """Each request has an effect on what its service publishes."""
    messages, cell = read(whole)
    keys = {SERVED["regulator"].key, SERVED["arbiter"].key}
    served = [each for each in messages if each.topic in keys]
    assert len(served) == 8
    for lost in served[::2]:
        others = [each for each in messages if each is not lost]
        assert any(found.count for found in differences(others, cell, *COUPLED))
    place = [i for i, each in enumerate(messages) if each.topic == "arbiter/status"][100]
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
    path = recorded_later(tmp_path, before, ())
    with pytest.raises(DataError, match=f"does not reach back far enough for {role}: .*{text}"):
        recorded_part(read(path)[0], role)
    done = run("replay", path, "--to-service", role)
    assert (done.exit_code, done.stdout) == (2, "")
    assert "`forcemesh record start --past` includes the minutes in memory" in done.stderr


def test_a_process_that_was_restarted_is_replayed_until_then(tmp_path: Path) -> None:
    """What another process published is not compared with the first one."""
    cell = RecordedCell(tmp_path)
    cell.world.advance(READY_S)
    cell.record("first", past=True)
    world: Any = cell.world
    world.kill("arbiter")
    bus = world._bus("arbiter")
    world._add("arbiter", ArbiterService(bus, world.cell), bus)
    world.advance(1.0)
    messages, config = read(cell.stop("first"))
    (note,) = recorded_part(messages, "arbiter").notes
    assert note == "only until its process was restarted 1.600 s later"
    assert differences(messages, config, "arbiter")[0].count == 0

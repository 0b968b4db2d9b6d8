"""Replay of a recorded cell through its services: byte-equal, or the difference is reported."""

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from cli.__main__ import app
from cli.replay_differences import Differences, Published, compared
from cli.replay_parts import recorded_part
from cli.replay_service import replayed
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.codec import pack, unpack
from forcemesh.requests import ArmRequest, CalibrationRequest, Empty, HoldRequest
from forcemesh.topics import SERVED, TOPICS
from services.arbiter.service import ArbiterService
from services.recorder.reading import RecordedBytes, RecordedFile
from services.regulator.gains import PiGains
from services.regulator.service import Regulator
from tests.fakes.recorded_cell import Job, RecordedCell, recorded_from_start, recorded_later

NOT_EQUAL = re.compile(r"[1-9]\d* in all fields|[1-9]\d* differ\b")
# Free of contact at its end: what the monitors of the arbiter remember is that of a new process.
BEFORE: Job = (
    (topics.ARM, ArmRequest(), 0.3),
    (topics.HOLD, HoldRequest(reason="before"), 0.2),
    (topics.CLEAR, Empty(), 0.2),
)
COUPLED = ("regulator", "arbiter")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording from the start of the cell: tare, arm, move, press, gains, stop, hold, clear."""
    return recorded_from_start(tmp_path_factory.mktemp("whole"))


@pytest.fixture(scope="module")
def later(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of a cell that has been armed before."""
    return recorded_later(tmp_path_factory.mktemp("later"), BEFORE)


def run(*words: object) -> tuple[int, str, str]:
    """Run the command line; return exit code, standard output and error."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.stdout, result.stderr


class Loaded:
    """A recording in memory, and what its services publish from it or from a changed one."""

    def __init__(self, path: Path) -> None:
        """Read a file."""
        read = RecordedFile(path)
        assert read.cell is not None
        self.cell: CellConfig = read.cell
        self.messages = list(read.raw_messages())
        self.baseline = self.outcome(self.messages, COUPLED)[0]

    def outcome(
        self, messages: list[RecordedBytes], roles: tuple[str, ...]
    ) -> tuple[dict[str, Published], list[Differences]]:
        """Return what roles publish from messages, and how it differs from the recording.

        Without the last moments of the recording, which are not compared.
        """
        parts = [recorded_part(messages, role) for role in roles]
        published = replayed(messages, parts, self.cell)
        within = {
            part.role: {
                key: data
                for key, data in published[part.role].items()
                if part.steps[key[1]].at_ns <= part.until_ns
            }
            for part in parts
        }
        return within, [compared(part, published[part.role], 0) for part in parts]


@pytest.fixture(scope="module")
def loaded(whole: Path) -> Loaded:
    """The recording in memory."""
    return Loaded(whole)


@pytest.mark.parametrize("role", ["wrench", "regulator", "arbiter", "cell", "arbiter,wrench"])
@pytest.mark.parametrize("from_start", [True, False])
def test_a_recorded_cell_is_replayed_byte_for_byte(
    whole: Path, later: Path, role: str, *, from_start: bool
) -> None:
    """Each service alone and coupled, from the start of the cell and from a moment within it."""
    code, out, err = run("replay", whole if from_start else later, "--to-service", role)
    assert (code, err) == (0, "")
    assert not NOT_EQUAL.search(out), out
    counts = re.findall(r"(\d+) recorded, (\d+) now: (\d+) equal byte for byte", out)
    assert len(counts) >= 2
    assert all(recorded == now == equal for recorded, now, equal in counts)
    assert int(counts[0][0]) > 300
    assert ("its start" in out) == from_start


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
    code, out, _ = run("replay", whole, "--to-service", "regulator")
    assert code == 1
    assert "pose.position_m.2: differs by at most" in out
    first = (
        r"first differences:\n +\d+\.\d{3} s regulator/target pose\.\S+: recorded \S+, now \S+\n"
    )
    assert re.search(first, out)
    code, out, _ = run("replay", whole, "--to-service", "cell")
    assert code == 1
    assert re.search(r"robot/command pose\.\S+: recorded", out), "the arbiter is coupled to it"
    assert run("replay", whole, "--to-service", "wrench")[0] == 0


@pytest.mark.parametrize(
    ("role", "service", "times", "text"),
    [
        ("arbiter", ArbiterService, 0, "command message: recorded published, now not published"),
        ("regulator", Regulator, 2, "target message: recorded not published, now published"),
    ],
)
def test_a_service_that_publishes_less_or_more_is_shown(
    whole: Path, monkeypatch: pytest.MonkeyPatch, role: str, service: Any, times: int, text: str
) -> None:
    """One message that is missing now, or one too many, is a difference of its own."""
    step, count = service.step, 0

    def uneven(self: Any, now_ns: int) -> None:
        nonlocal count
        count += 1
        for _ in range(times if count == 400 else 1):
            step(self, now_ns)

    monkeypatch.setattr(service, "step", uneven)
    code, out, _ = run("replay", whole, "--to-service", role)
    assert code == 1
    assert text in out


INPUTS = {topic.key for topic in TOPICS if {"regulator", "arbiter"} & set(topic.readers)} - {
    "regulator/target",
    "robot/command",
    "arbiter/status",
}


@given(data=st.data())
@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_an_input_that_is_lost_or_altered_is_reported_or_has_no_effect(
    loaded: Loaded, data: st.DataObject
) -> None:
    """Any one recorded message that the coupled services read."""
    places = [i for i, each in enumerate(loaded.messages) if each.topic in INPUTS]
    place = data.draw(st.sampled_from(places))
    each = loaded.messages[place]
    altered = data.draw(st.sampled_from(("lost", "cut", "numbers")))
    changed = [] if altered == "lost" else [each._replace(data=damaged(each.data, altered))]
    messages = [*loaded.messages[:place], *changed, *loaded.messages[place + 1 :]]
    published, differences = loaded.outcome(messages, COUPLED)
    has_effect = published != loaded.baseline
    assert any(found.count for found in differences) == has_effect


def damaged(data: bytes, kind: str) -> bytes:
    """Return a message without its end, or with other numbers."""
    if kind == "cut":
        return data[:-1]
    fields = unpack(data)
    changed = {
        name: tuple(1.01 * part + 1e-3 for part in value)
        for name, value in fields.items()
        if isinstance(value, tuple) and all(isinstance(part, float) for part in value)
    }
    return pack(fields | changed)


@pytest.mark.parametrize("number", range(8))
def test_a_request_that_is_lost_is_reported(loaded: Loaded, number: int) -> None:
    """Each of them has an effect on what its service publishes."""
    keys = {SERVED["regulator"].key, SERVED["arbiter"].key}
    served = [each for each in loaded.messages if each.topic in keys]
    assert len(served) == 8
    messages = [each for each in loaded.messages if each is not served[number]]
    _, differences = loaded.outcome(messages, COUPLED)
    assert any(found.count for found in differences)


@given(share=st.floats(0.2, 1.0))
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_recording_that_ends_anywhere_is_replayed_byte_for_byte(
    loaded: Loaded, share: float
) -> None:
    """Also within a step: the last moments are not compared."""
    messages = loaded.messages[: round(share * len(loaded.messages))]
    _, differences = loaded.outcome(messages, COUPLED)
    assert [found.count for found in differences] == [0, 0]


def test_a_request_that_the_recording_cannot_hold_is_named(tmp_path: Path) -> None:
    """A calibration may be longer than a message; a refused one changes nothing."""
    cell = RecordedCell(tmp_path)
    cell.world.advance(0.5)
    cell.record("long", past=True)
    request = CalibrationRequest(calibration_json="x" * 3000)
    assert not cell.world.client.ask(topics.CALIBRATE, request).accepted
    cell.world.advance(0.2)
    code, out, _ = run("replay", cell.stop("long"), "--to-service", "wrench")
    assert code == 1
    assert "note: not replayed: request/calibration of 30" in out
    assert "wrench/requests message: recorded published, now not published" in out

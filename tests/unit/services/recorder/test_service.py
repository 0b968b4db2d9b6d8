"""The recorder's service: files by request and by fault, refusals, and failures of the disk."""

import random
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from forcemesh import topics
from forcemesh.messages import ArbiterStatus, WrenchAtTcp
from services.recorder import recording, service
from services.recorder.reading import RecordedFile
from tests.unit.services.recorder.conftest import TRIP, RecorderBench

STEP_S = 0.1

Begin = Callable[..., RecorderBench]


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Begin]:
    """Start recorders with their own settings and end all of them."""
    begun: list[RecorderBench] = []

    def start(folder: Path = tmp_path, **section: Any) -> RecorderBench:
        begun.append(RecorderBench(folder, **section))
        return begun[-1]

    yield start
    for bench in begun:
        bench.recorder.close()


def numbers(path: Path, topic: str = "wrench") -> list[int]:
    """Return the numbers of a topic's messages in a file."""
    return [message.fields["seq"] for message in RecordedFile(path).messages(topic)]


def events(path: Path) -> list[str]:
    """Return the events during a recording, which must be complete."""
    read = RecordedFile(path)
    assert list(read.messages())
    assert read.is_whole
    return [event.code for event in read.events]


# --- by request -----------------------------------------------------------------------------------


@pytest.mark.parametrize("past", [False, True])
def test_it_records_from_a_start_to_a_stop(begin: Begin, past: bool) -> None:
    """Exactly the messages in between, or also those in memory; to the end of a process as well."""
    bench = begin()
    bench.pass_s(1.0)
    started = bench.start(label="my try / no 1", past=past)
    bench.pass_s(2.0)
    stopped = bench.stop()
    bench.pass_s(1.0)
    (path,) = bench.files()
    assert started.accepted
    assert path.name == "demo-20270115T080002Z-my-try-no-1-01.mcap"
    assert str(path) in started.text
    assert " messages, 0 lost" in stopped.text
    assert numbers(path) == list(range(1 if past else 11, 31))
    assert events(path) == []
    bench.start()
    bench.pass_s(1.3)
    bench.recorder.close()
    assert numbers(bench.files()[-1]) == list(range(41, 54))
    assert events(bench.files()[-1]) == []


def test_a_repeated_request_is_refused(begin: Begin) -> None:
    """A start during a recording and a stop without one are refused without effect."""
    bench = begin()
    assert bench.stop().code == "already"
    bench.start()
    assert bench.start().code == "already"
    bench.pass_s(0.5)
    assert bench.status().recording
    assert bench.stop().accepted


def test_lost_messages_are_counted(begin: Begin) -> None:
    """Gaps in the writer's numbers count; a restarted writer has lost nothing."""
    bench = begin()
    bench.start()
    bench.pass_s(0.5)
    bench._publishers["wrench"].seq += 7
    bench.pass_s(0.5)
    assert bench.recorder.counters()["lost"] == 7
    bench.replace_writer(topics.WRENCH)
    bench.pass_s(0.5)
    assert bench.status().lost == 7


# --- by a stop of the arm -------------------------------------------------------------------------


def test_a_fault_writes_memory_to_a_file_and_records_for_a_while(begin: Begin) -> None:
    """Without a request the file has the time before the fault, its code, and some seconds more."""
    bench = begin(after_fault_s=3.0)
    bench.pass_s(5.0)
    bench.trip()
    assert bench.status().recording
    assert bench.status().cause == "force"
    bench.pass_s(6.0)
    assert not bench.status().recording
    (path,) = bench.files()
    assert "-STOP-force" in path.name
    read = RecordedFile(path)
    assert read.about["cause"] == "force"
    assert numbers(path) == list(range(1, 83))
    assert [event.code for event in read.events] == ["force"]
    last = list(read.messages("arbiter/status"))[-1]
    assert last.at_ns == read.events[0].at_ns - round(STEP_S * 1e9)


def test_without_a_new_stop_or_without_memory_nothing_is_written(begin: Begin) -> None:
    """A change into another state, a stop from before the start, and keep_min 0."""
    bench = begin()
    stopped = ArbiterStatus.from_dict({"state": "FAULT", "trips": (TRIP,)})
    bench.put(topics.ARBITER_STATUS, stopped)
    bench.pass_s(1.0)
    for state in ("IDLE", "BOOT"):
        bench.trip(state)
    without = begin(keep_min=0.0)
    without.pass_s(1.0)
    without.trip()
    assert bench.files() == []
    assert without.status().memory_s == 0.0


def test_a_stop_soon_after_another_one_has_its_own_file(begin: Begin) -> None:
    """A force stop in the tail of an ordinary hold: both are kept, each with the time before."""
    bench = begin(after_fault_s=10.0)
    bench.pass_s(2.0)
    bench.trip(code="hold")
    bench.pass_s(1.0)
    bench.trip(code="force")
    bench.pass_s(12.0)
    causes = {RecordedFile(path).about["cause"]: path for path in bench.files()}
    assert set(causes) == {"hold", "force"}
    assert events(causes["hold"]) == ["hold", "force"]
    assert events(causes["force"]) == ["force"]
    assert numbers(causes["force"])[0] == 1  # memory, from before both


def test_memory_stays_within_its_time_and_size(begin: Begin) -> None:
    """Old seconds are dropped, and more of them with a small size."""
    bench = begin(keep_min=0.1)
    bench.pass_s(30.0)
    assert 5.0 < bench.status().memory_s <= 7.0
    full = begin(memory_MB=1.0)
    full.recorder._ring_buffer._most_bytes = 1500
    full.pass_s(30.0)
    assert 0 < full.status().memory_bytes <= 2000


# --- its disk -------------------------------------------------------------------------------------


def test_it_stops_before_the_disk_is_full(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """Below the minimum of free space it ends the file with a reason and begins no new one."""
    bench = begin(least_free_GB=2.0)
    free = [3_000_000_000]
    monkeypatch.setattr(service, "free_bytes", lambda _: free[0])
    bench.start()
    bench.pass_s(2.0)
    free[0] = 1_900_000_000
    bench.pass_s(2.0)
    status = bench.status()
    assert (status.recording, status.valid, status.code) == (False, False, "recording")
    assert "recording stopped: 1.9 GB are free" in status.reason
    assert bench.recorder.fault == status.reason
    assert RecordedFile(bench.files()[0]).cell is not None
    assert bench.start().code == "recording"
    bench.trip()
    assert len(bench.files()) == 1
    free[0] = 3_000_000_000
    bench.pass_s(2.0)
    assert bench.recorder.fault == ""
    assert bench.start().accepted


def test_a_disk_that_fails_ends_the_recording_and_not_the_recorder(begin: Begin) -> None:
    """What was written before is read; it reports this, receives, and records when it can."""
    bench = begin()
    bench.start()
    bench.pass_s(2.0)
    (path,) = bench.files()
    with largest_file(path.stat().st_size + 100):
        bench.pass_s(2.0)
    assert "File too large" in bench.recorder.fault
    assert not bench.status().recording
    read = RecordedFile(path)
    found = [message.fields["seq"] for message in read.messages("wrench")]
    assert found == list(range(1, len(found) + 1))
    assert (len(found) >= 15, read.is_whole) == (True, False)
    assert bench.start(past=True).accepted
    assert bench.recorder.fault == ""
    bench.stop()
    assert len(numbers(bench.files()[-1])) == 40
    reply = begin(folder=Path(__file__) / "folder").start()
    assert reply.code == "recording"
    assert "Not a directory" in reply.text


@contextmanager
def largest_file(size_B: int) -> Iterator[None]:
    """Let the system refuse to write beyond a size, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_B, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_stop_loses_nothing_that_waits_to_be_written(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory that takes long to write: the file has all of it."""
    bench = begin()
    bench.pass_s(5.0)
    write = recording.Recording.write

    def slowly(*arguments: Any) -> None:
        bench.clock.sleep_s(0.5)
        write(*arguments)

    monkeypatch.setattr(recording.Recording, "write", slowly)
    bench.start(past=True)
    bench.stop()
    assert numbers(bench.files()[0]) == list(range(1, 51))


@pytest.mark.parametrize(("limit", "most_B"), [({"file_min": 0.1}, 9e9), ({"file_MB": 1.0}, 2e6)])
def test_long_recordings_are_several_whole_files(
    begin: Begin, limit: dict[str, float], most_B: float
) -> None:
    """Cut by time or by size, nothing is lost between two files, and each has its metadata."""
    bench, letters = begin(**limit), random.Random(1)
    bench.start()
    for _ in range(70):
        for _ in range(50):
            text = "".join(map(chr, letters.choices(range(0x4E00, 0x9000), k=390)))
            bench.put(topics.WRENCH, WrenchAtTcp(reason=text))
        bench.step()
    bench.stop()
    files = bench.files()
    assert len(files) > 1
    assert [number for path in files for number in numbers(path)] == list(range(1, 3501))
    assert all(RecordedFile(path).cell is not None for path in files)
    assert all(path.stat().st_size < most_B for path in files)


def test_a_fault_during_a_recording_is_noted_in_it_and_one_before_has_its_own(
    begin: Begin,
) -> None:
    """A requested recording ends one of a fault, and continues until a stop."""
    bench = begin(after_fault_s=1.0)
    bench.pass_s(1.0)
    bench.trip()
    assert bench.start().accepted
    bench.trip()
    bench.pass_s(3.0)
    assert (bench.status().recording, bench.status().cause) == (True, "asked")
    bench.stop()
    causes = {RecordedFile(path).about["cause"]: path for path in bench.files()}
    assert set(causes) == {"force", "asked"}
    assert events(causes["asked"]) == ["force"]

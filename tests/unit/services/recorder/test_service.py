"""The recorder's service: what it writes when, what it refuses, what the disk may do to it."""

import errno
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from forcemesh import topics
from forcemesh.messages import ArbiterState, ArbiterStatus, WrenchAtTcp
from services.recorder import recording
from services.recorder import recording_writer as tape
from services.recorder.reading import RecordedFile
from tests.fakes.recorder_bench import RecorderBench

STEP_S = 0.1

Begin = Callable[..., RecorderBench]


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Begin]:
    """Start recorders with settings of their own; all of them are ended."""
    begun: list[RecorderBench] = []

    def start(folder: Path = tmp_path, **section: Any) -> RecorderBench:
        begun.append(RecorderBench(folder, **section))
        return begun[-1]

    yield start
    for bench in begun:
        bench.recorder.close()


def numbers(path: Path, topic: str = "wrench") -> list[int]:
    """Return the numbers of a topic's messages in a file."""
    return [said.fields["seq"] for said in RecordedFile(path).messages(topic)]


def events(path: Path) -> list[str]:
    """Return what happened during a recording; the file is whole."""
    read = RecordedFile(path)
    assert list(read.messages())
    assert read.is_whole
    return [event.code for event in read.events]


def test_it_records_from_a_start_to_a_stop(begin: Begin) -> None:
    """Every message between the two and none outside, in one whole file; the answers name it."""
    bench = begin()
    bench.pass_s(1.0)
    started = bench.start(label="my try / no 1")
    bench.pass_s(2.0)
    stopped = bench.stop()
    bench.pass_s(1.0)
    (path,) = bench.files()
    assert started.accepted
    assert path.name == "demo-20270115T080002Z-my-try-no-1-01.mcap"
    assert str(path) in started.text
    assert " messages, 0 lost" in stopped.text
    assert numbers(path) == list(range(11, 31))
    read = RecordedFile(path)
    assert len(list(read.messages("wrench"))) == 20
    assert read.is_whole


def test_a_recording_may_begin_in_the_past(begin: Begin) -> None:
    """With what memory holds before it, without a gap between memory and now."""
    bench = begin()
    bench.pass_s(5.0)
    bench.start(past=True)
    bench.pass_s(1.0)
    bench.stop()
    assert numbers(bench.files()[0]) == list(range(1, 61))


def test_a_fault_writes_memory_out_and_goes_on_for_a_while(begin: Begin) -> None:
    """Nobody asked: the minutes before, the fault itself by its code, and some seconds after it."""
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


@pytest.mark.parametrize("state", ["IDLE", "BOOT"])
def test_an_arm_that_was_not_stopped_is_no_fault(begin: Begin, state: ArbiterState) -> None:
    """Only the change into a stop counts: neither other states nor a stop found at the start."""
    bench = begin()
    bench.pass_s(0.5)
    bench.trip(state)
    assert bench.files() == []


def test_a_stop_that_was_there_before_is_no_new_fault(begin: Begin) -> None:
    """A recorder that is started while the arm is held writes nothing."""
    bench = begin()
    bench.say(topics.ARBITER_STATUS, ArbiterStatus(state="FAULT"))
    bench.pass_s(1.0)
    assert bench.files() == []


def test_a_fault_during_a_recording_is_noted_in_it(begin: Begin) -> None:
    """One file, which goes on until it is stopped."""
    bench = begin(after_fault_s=1.0)
    bench.start()
    bench.trip()
    bench.pass_s(3.0)
    assert bench.status().recording
    bench.stop()
    (path,) = bench.files()
    read = RecordedFile(path)
    assert len(list(read.messages())) > 30
    assert [event.code for event in read.events] == ["force"]


def test_a_stop_right_after_another_one_has_its_file_by_its_own_code(begin: Begin) -> None:
    """A force stop in the tail of a daily hold: both are kept apart, each with what was before."""
    bench = begin(after_fault_s=10.0)
    bench.pass_s(2.0)
    bench.trip(code="hold")
    bench.pass_s(1.0)
    bench.trip(code="force")
    bench.pass_s(12.0)
    causes = {RecordedFile(path).about["cause"]: path for path in bench.files()}
    assert set(causes) == {"hold", "force"}
    assert "-STOP-force" in causes["force"].name
    assert events(causes["hold"]) == ["hold", "force"]
    assert events(causes["force"]) == ["force"]
    assert numbers(causes["force"])[0] == 1  # memory, from before both


def test_the_same_stop_again_goes_on_in_its_file(begin: Begin) -> None:
    """Two of a kind within the seconds after the first: one file, as long after the second."""
    bench = begin(after_fault_s=3.0)
    bench.trip()
    bench.pass_s(2.0)
    bench.trip()
    bench.pass_s(2.0)
    assert bench.status().recording
    bench.pass_s(3.0)
    (path,) = bench.files()
    assert events(path) == ["force", "force"]


def test_what_a_fault_began_gives_way_to_a_start(begin: Begin) -> None:
    """A person's recording is a file of its own and does not end by itself."""
    bench = begin(after_fault_s=1.0)
    bench.pass_s(1.0)
    bench.trip()
    assert bench.start().accepted
    bench.pass_s(3.0)
    assert bench.status().recording
    assert bench.status().cause == "asked"
    assert len(bench.files()) == 2


def test_only_so_many_faults_are_kept(begin: Begin) -> None:
    """The oldest goes; what a person recorded stays, and what another fault began."""
    bench = begin(after_fault_s=0.0, faults_kept=2)
    bench.start(label="STOP-of-mine")
    bench.stop()
    for code in ("rare", *["force"] * 4):
        bench.trip(code=code)
        bench.pass_s(2.0)
    kept = [path.name for path in bench.files() if "STOP" in path.name]
    assert sorted("rare" in name for name in kept) == [False, False, True]
    assert len(bench.files()) == 4


def test_long_recordings_are_several_whole_files(begin: Begin) -> None:
    """Cut by time; nothing is lost between two files, and each says what it is of."""
    bench = begin(file_min=0.1)
    bench.start()
    bench.pass_s(20.0)
    bench.stop()
    files = bench.files()
    assert len(files) == 4
    assert [number for path in files for number in numbers(path)] == list(range(1, 201))
    assert all(RecordedFile(path).cell is not None for path in files)


def test_large_recordings_are_several_files(begin: Begin) -> None:
    """Cut by size."""
    bench = begin(file_MB=1.0)
    bench.start()
    noise = iter(range(10**9))
    for _ in range(60):
        for _ in range(200):
            text = "".join(chr(0x4E00 + (next(noise) * 7919) % 20000) for _ in range(100))
            bench.say(topics.WRENCH, WrenchAtTcp(reason=text))
        bench.pass_s(STEP_S)
    bench.stop()
    assert len(bench.files()) > 1
    assert all(path.stat().st_size < 2e6 for path in bench.files())


def test_asking_twice_is_refused(begin: Begin) -> None:
    """Start while it records, stop while it does not: refused, and nothing changes."""
    bench = begin()
    assert bench.stop().code == "already"
    bench.start()
    assert bench.start().code == "already"
    bench.pass_s(0.5)
    assert bench.status().recording
    assert bench.stop().accepted
    assert bench.stop().code == "already"


def test_it_stops_before_the_disk_is_full(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """With less than the least space it ends the file, says why, and begins nothing new."""
    bench = begin(least_free_GB=2.0)
    free = [3_000_000_000]
    monkeypatch.setattr(tape, "free_bytes", lambda _: free[0])
    bench.start()
    bench.pass_s(2.0)
    free[0] = 1_900_000_000
    bench.pass_s(2.0)
    status = bench.status()
    assert not status.recording
    assert not status.valid
    assert status.code == "recording"
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


def test_a_disk_that_fails_ends_the_recording_and_not_the_recorder(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says so, goes on hearing, and records again when the disk is well."""
    bench = begin()
    bench.start()
    with monkeypatch.context() as broken:

        def refuse(*_: object) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        broken.setattr(recording.RecordingFile, "flush", refuse)
        bench.pass_s(2.0)
    assert "No space left on device" in bench.recorder.fault
    assert not bench.status().recording
    assert bench.start(past=True).accepted
    assert bench.recorder.fault == ""
    bench.stop()
    assert len(numbers(bench.files()[-1])) == 20


def test_a_folder_that_cannot_be_made_is_a_refusal(tmp_path: Path, begin: Begin) -> None:
    """A file stands in the way: the answer says where and why."""
    (tmp_path / "file").write_text("in the way")
    bench = begin(folder=tmp_path / "file" / "folder")
    reply = bench.start()
    assert reply.code == "recording"
    assert "Not a directory" in reply.text


def test_what_was_lost_on_the_way_is_counted(begin: Begin) -> None:
    """By the gaps in the writer's numbers; a writer that begins anew has lost nothing."""
    bench = begin()
    bench.start()
    bench.pass_s(0.5)
    bench._writers["wrench"].seq += 7
    bench.pass_s(0.5)
    assert bench.recorder.counters()["lost"] == 7
    bench._writers.clear()
    bench._writers["wrench"] = bench._bus("wrench").publisher(topics.WRENCH)
    bench.pass_s(0.5)
    assert bench.status().lost == 7


def test_memory_keeps_within_its_time_and_its_room(begin: Begin) -> None:
    """Old seconds go; with little room more of them do."""
    bench = begin(keep_min=0.1)
    bench.pass_s(30.0)
    assert 5.0 < bench.status().memory_s <= 7.0
    full = begin(memory_MB=1.0)
    full.recorder._past._most_bytes = 1500
    full.pass_s(30.0)
    assert 0 < full.status().memory_bytes <= 2000


def test_without_memory_a_fault_writes_nothing(begin: Begin) -> None:
    """keep_min 0 switches the flight recorder off."""
    bench = begin(keep_min=0.0)
    bench.pass_s(1.0)
    bench.trip()
    assert bench.files() == []
    assert bench.status().memory_s == 0.0


def test_the_end_of_the_process_finishes_the_file(begin: Begin) -> None:
    """A recorder that is told to end loses nothing of what it heard."""
    bench = begin()
    bench.start()
    bench.pass_s(1.3)
    bench.recorder.close()
    read = RecordedFile(bench.files()[0])
    assert len(list(read.messages())) >= 13
    assert read.is_whole


def test_bytes_of_strangers_are_kept_and_harm_nothing(begin: Begin) -> None:
    """Noise, a message of another version and of another form: all of it to the byte."""
    bench = begin()
    bench.start()
    strange = [b"", b"\xc1", b"\x80", b"\x81\xa3seq\xcf" + b"\xff" * 8, b"\xa3abc"]
    for data in strange:
        bench.say_bytes(topics.SENSOR_WRENCH, data)
        bench.pass_s(STEP_S)
    bench.stop()
    read = RecordedFile(bench.files()[0])
    assert [h.data for h in read.raw_messages() if h.topic == "sensor/wrench"] == strange
    assert len(list(read.messages("wrench"))) == len(strange)

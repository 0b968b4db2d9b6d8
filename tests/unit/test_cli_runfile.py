"""Run files: what a supervisor leaves for whoever asks later."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cli.context import default_cell_file, find_cell_file
from cli.runfile import (
    FOLDER_VARIABLE,
    Ended,
    Entry,
    Run,
    is_alive,
    new_run,
    read_run,
    read_runs,
    remove_run,
    start_ticks,
    writable_folder,
    write_run,
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run files of this test alone."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "run"))
    writable_folder()
    return tmp_path / "run"


def a_run(cell: str, *, live: bool = True, started_at: str = "2026-01-01T00:00:00") -> Run:
    """Return a run of this very process, or one that is over; its cell file exists."""
    run = new_run(cell, Path(__file__)).model_copy(update={"started_at": started_at})
    if live:
        return run
    return run.model_copy(update={"ended_at": "2026-01-01T01:00:00"})


def test_a_run_is_read_as_it_was_written() -> None:
    """Every field survives, also how a process ended."""
    ended = Ended(code=-9, how="killed by SIGKILL", at="2026-01-01T00:00:01")
    entry = Entry(roles=("robot", "sensor"), module="m", pid=7, started_ticks=8, ended=ended)
    run = a_run("one").model_copy(update={"processes": [entry], "last_state": "HOLDING"})
    write_run(run)
    assert read_run("one") == run
    assert run.entry("sensor") == entry
    assert run.entry("hub") is None
    remove_run(run)
    assert read_run("one") is None


def test_a_file_that_is_no_run_file_is_passed_over(folder: Path) -> None:
    """Half a file or somebody else's file keeps nobody from asking."""
    write_run(a_run("one"))
    (folder / "two.json").write_text('{"cell": "two"')
    (folder / "three.json").write_text("[]")
    assert [run.cell for run in read_runs()] == ["one"]


def test_live_runs_come_first_and_newer_ones_before_older_ones() -> None:
    """The cell that is up is the one that is meant."""
    write_run(a_run("old", started_at="2026-01-01T00:00:00"))
    write_run(a_run("new", started_at="2026-01-02T00:00:00"))
    write_run(a_run("over", live=False, started_at="2026-01-03T00:00:00"))
    assert [run.cell for run in read_runs()] == ["new", "old", "over"]


def test_a_process_is_alive_only_under_its_own_start_time() -> None:
    """A pid that was given to somebody else since is not the process that was started."""
    pid = os.getpid()
    assert is_alive(pid, start_ticks(pid))
    assert not is_alive(pid, (start_ticks(pid) or 0) - 1)


def test_a_zombie_is_not_alive() -> None:
    """A dead process that nobody has waited for yet still has its pid."""
    child = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    ticks = start_ticks(child.pid)
    assert child.stdout is not None
    child.stdout.read()  # ends when the process does
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
    assert not is_alive(child.pid, ticks)
    child.stdout.close()
    child.wait()


def test_the_cell_that_is_up_is_meant_without_being_named() -> None:
    """`up` in one terminal, verbs in another: no need to repeat the file."""
    assert find_cell_file(None) == default_cell_file()
    write_run(a_run("over", live=False))
    assert find_cell_file(None) == default_cell_file()
    assert find_cell_file(None, ended=True) == Path(__file__)
    write_run(a_run("up").model_copy(update={"cell_file": "up.yaml"}))
    assert find_cell_file(None, ended=True) == Path("up.yaml")
    assert find_cell_file(Path("named.yaml")) == Path("named.yaml")


def test_a_folder_that_cannot_be_made_falls_back_to_the_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A read-only image still has run files; nobody else may write there."""
    monkeypatch.delenv(FOLDER_VARIABLE)
    (tmp_path / "file").touch()
    monkeypatch.setattr("cli.runfile.ROOT", tmp_path / "file")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = writable_folder()
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o077 == 0

"""Run files: the record of a supervisor for later commands."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cli.context import default_cell_file, find_cell_file, live_cell
from common.config.load import cell_hash, dump_cell
from forcemesh.errors import ConfigError, DataError
from launch.run_file import (
    FOLDER_VARIABLE,
    ExitRecord,
    ProcessRecord,
    Run,
    is_alive,
    new_run,
    read_run,
    read_runs,
    start_ticks,
    writable_folder,
)
from tests.fakes.bench import CELL


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run files of this test only."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "run"))
    writable_folder()
    return tmp_path / "run"


def a_run(cell: str, *, live: bool = True, started_at: str = "2026-01-01T00:00:00") -> Run:
    """Return a run of this process, or an ended one; its cell file exists."""
    named = CELL.model_copy(update={"cell": cell})
    run = new_run(named, Path(__file__)).model_copy(update={"started_at": started_at})
    if live:
        return run
    return run.model_copy(update={"ended_at": "2026-01-01T01:00:00"})


def test_a_run_round_trips() -> None:
    """Every field is kept, also how a process ended."""
    ended = ExitRecord(code=-9, how="killed by SIGKILL", at="2026-01-01T00:00:01")
    entry = ProcessRecord(
        roles=("robot", "sensor"), module="m", pid=7, started_ticks=8, ended=ended
    )
    run = a_run("one").model_copy(update={"processes": [entry], "last_state": "HOLDING"})
    run.write()
    assert read_run("one") == run
    assert run.entry("sensor") == entry
    assert run.entry("hub") is None
    run.remove()
    assert read_run("one") is None


def test_live_runs_come_first_and_newer_ones_before_older_ones(folder: Path) -> None:
    """The running cell is the default; a truncated file or a foreign one is ignored."""
    a_run("old", started_at="2026-01-01T00:00:00").write()
    a_run("new", started_at="2026-01-02T00:00:00").write()
    a_run("over", live=False, started_at="2026-01-03T00:00:00").write()
    (folder / "two.json").write_text('{"cell": "two"')
    (folder / "three.json").write_text("[]")
    assert [run.cell for run in read_runs()] == ["new", "old", "over"]


def test_a_process_is_alive_only_under_its_own_start_time() -> None:
    """A reused pid is not the process that was started."""
    pid = os.getpid()
    assert is_alive(pid, start_ticks(pid))
    assert not is_alive(pid, (start_ticks(pid) or 0) - 1)


def test_a_zombie_is_not_alive() -> None:
    """A dead process that was not yet waited for still has its pid."""
    child = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    ticks = start_ticks(child.pid)
    assert child.stdout is not None
    child.stdout.read()  # ends when the process does
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
    assert not is_alive(child.pid, ticks)
    child.stdout.close()
    child.wait()


def test_a_running_cell_is_used_as_it_was_started(tmp_path: Path) -> None:
    """Later edits of its file do not matter: a hold does not wait for a valid file."""
    path = tmp_path / "cell.yaml"
    path.write_text(dump_cell(CELL))
    assert find_cell_file(None) == default_cell_file()
    new_run(CELL, path).write()
    assert find_cell_file(None) == path
    assert cell_hash(live_cell(path)) == cell_hash(CELL)
    path.write_text("cell: [")
    assert cell_hash(live_cell(path)) == cell_hash(CELL)
    path.write_text(dump_cell(CELL))
    new_run(CELL, path).model_copy(update={"as_started": '{"of": "another version"}'}).write()
    assert cell_hash(live_cell(path)) == cell_hash(CELL)
    (tmp_path / "other.yaml").write_text("cell: [")
    with pytest.raises(ConfigError):
        live_cell(tmp_path / "other.yaml")


def test_a_run_file_contains_no_token() -> None:
    """Other users of the machine may read it."""
    secret = CELL.model_copy(update={"panel": CELL.panel.model_copy(update={"token": "s3cret"})})
    assert "s3cret" not in new_run(secret, Path(__file__)).as_started


@pytest.mark.parametrize("spoil", ["owner", "link", "mode"])
def test_a_folder_that_another_user_can_change_is_neither_read_nor_written(
    spoil: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The temporary directory is everyone's: the error names the folder and the remedy."""
    monkeypatch.delenv(FOLDER_VARIABLE)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    (tmp_path / "file").touch()
    monkeypatch.setattr("launch.run_file.ROOT", tmp_path / "file")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    uid = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    folder = tmp_path / "forcemesh-12345"
    if spoil == "link":
        folder.symlink_to(tmp_path, target_is_directory=True)
    else:
        folder.mkdir(mode=0o700)
    run = a_run("one").model_dump_json()
    (folder / "one.json").write_text(run)
    if spoil == "mode":
        monkeypatch.setattr(os, "getuid", lambda: uid)
        folder = folder.rename(tmp_path / f"forcemesh-{uid}")
        assert read_run("one") is not None
        folder.chmod(0o777)
    assert read_runs() == []
    with pytest.raises(DataError, match=f"{folder}: .* user.*{FOLDER_VARIABLE}"):
        writable_folder()


def test_the_runtime_folder_of_the_user_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then that of the checkout; runs in either are found."""
    monkeypatch.delenv(FOLDER_VARIABLE)
    monkeypatch.setattr("launch.run_file.ROOT", tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    assert writable_folder() == tmp_path / ".run"
    a_run("one").write()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert writable_folder() == tmp_path / "forcemesh"
    a_run("two").write()
    assert {run.cell for run in read_runs()} == {"one", "two"}

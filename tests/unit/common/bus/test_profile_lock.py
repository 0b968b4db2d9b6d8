"""One cell has one cell file: tests of its publication, of waiting for it and of refusals."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from common.bus.profile_fit import Choice
from common.bus.profile_lock import (
    LOCK_PATIENCE_S,
    acquire,
    announce,
    check,
    chosen,
    hold,
    main,
    waiting,
)

ROOT = Path(__file__).resolve().parents[4]
CELLS = ROOT / "cells"
SIM = Choice("sim", CELLS / "demo.yaml")
EMULATED = Choice("emulated", CELLS / "emulated.yaml")
REAL = Choice("real", CELLS / "emulated.yaml")  # it has the implementations of a real one
LONG_S = 10.0
SAFE = {
    "FORCEMESH_BUS": "tls", "FORCEMESH_CERTIFICATES": "pki", "FORCEMESH_PANEL_TOKEN": "0" * 32,
    "FORCEMESH_CALIBRATION": "./calibration",
}  # fmt: skip


def end(lock: int | None) -> None:
    """End the process that has a lock."""
    assert lock is not None
    os.close(lock)


def until(what: Callable[[], Any]) -> Any:
    """Wait until something is so, and return it."""
    give_up_s = time.monotonic() + LONG_S
    while not (so := what()):
        assert time.monotonic() < give_up_s
        time.sleep(0.01)
    return so


@contextmanager
def process(
    folder: Path, file: Path, *words: str, patience_s: float = LOCK_PATIENCE_S
) -> Iterator[subprocess.Popen[str]]:
    """Run the module in a process of its own, with its volume at `folder`."""
    start = (
        f"from common.bus import profile_lock; profile_lock.LOCK_PATIENCE_S = {patience_s}; "
        f"profile_lock.main({list(words)!r}, Path({str(folder)!r}))"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", f"from pathlib import Path; {start}"],
        cwd=ROOT, env={**os.environ, **SAFE, "FORCEMESH_CELL": str(file)}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        yield started
    finally:
        started.kill()
        started.wait()
        for pipe in (started.stdout, started.stderr):
            assert pipe is not None
            pipe.close()


def line(of: subprocess.Popen[str]) -> str:
    """Return the next line that a process prints for people."""
    assert of.stderr is not None
    return of.stderr.readline()


# --- the lock -------------------------------------------------------------------------------------


def test_a_published_choice_is_in_use_for_the_containers_of_its_profile(tmp_path: Path) -> None:
    """The link leads to the cell file; the robot of another profile stays out."""
    assert chosen(tmp_path) is None
    assert hold(tmp_path, ()) is None
    acquire(tmp_path, SIM)
    assert (tmp_path / "cell.yaml").resolve() == SIM.file
    for profiles in ((), ("sim",), ("emulated", "sim")):
        assert hold(tmp_path, profiles) is not None
    assert hold(tmp_path, ("emulated", "real")) is None
    assert acquire(tmp_path, SIM) is not None  # started anew


@pytest.mark.parametrize(
    "other", [EMULATED, Choice("sim", EMULATED.file), Choice("real", SIM.file)]
)
def test_another_choice_is_refused_while_any_process_runs(tmp_path: Path, other: Choice) -> None:
    """One process of the cell is enough; the container that published it may have ended."""
    claimed = acquire(tmp_path, SIM)
    runs = hold(tmp_path, ())
    end(claimed)
    assert acquire(tmp_path, other) is None
    assert chosen(tmp_path) == SIM
    end(runs)
    assert acquire(tmp_path, other) is not None
    assert chosen(tmp_path) == other


def test_processes_that_run_at_the_same_time_have_the_same_cell_file(tmp_path: Path) -> None:
    """Two profiles and five processes start in any order: all that get to run agree."""
    for _ in range(20):
        running: list[tuple[int, Choice | None]] = []

        def start(
            what: Callable[[], int | None], running: list[tuple[int, Choice | None]] = running
        ) -> None:
            if (lock := what()) is not None:
                running.append((lock, chosen(tmp_path)))

        starts = [partial(acquire, tmp_path, each) for each in (SIM, EMULATED)]
        starts += [partial(hold, tmp_path, ()) for _ in range(5)]
        threads = [threading.Thread(target=start, args=(each,)) for each in starts]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert {choice for _, choice in running} == {chosen(tmp_path)}
        for lock, _ in running:
            os.close(lock)


# --- the processes --------------------------------------------------------------------------------


def test_a_process_starts_when_the_cell_file_is_there_and_holds_it_until_it_ends(
    tmp_path: Path,
) -> None:
    """It waits, becomes its command with the lock in hand, and its end gives the lock back."""
    command = "import time; print('runs', flush=True); time.sleep(60)"
    waits = ("run", "--", sys.executable, "-c", command)
    with process(tmp_path, SIM.file, *waits, patience_s=0.0) as service:
        assert "waits: no cell file is in use" in line(service)
        end(acquire(tmp_path, SIM))
        assert service.stdout is not None
        assert service.stdout.readline() == "runs\n"
        assert acquire(tmp_path, EMULATED) is None
    # The kernel ends the command after its parent: only then is the lock free.
    end(until(lambda: acquire(tmp_path, EMULATED)))


def test_a_refused_profile_reports_it_once_and_follows_when_the_other_has_ended(
    tmp_path: Path,
) -> None:
    """One sentence with the remedy, no loop; then it is the one in use."""
    with process(tmp_path, REAL.file, "keep", "real") as real:
        assert line(real) == f"real-cell: in use with {REAL.file}\n"
        with process(tmp_path, EMULATED.file, "keep", "emulated") as emulated:
            assert line(emulated) == (
                f"emulated-cell: the profile real is in use with {REAL.file}, and a cell has only "
                "one profile and file: first `docker compose --profile real down`, or remove this "
                "one: `docker compose --profile emulated rm -s -f emulated-cell`\n"
            )
            real.kill()
            assert line(emulated) == f"emulated-cell: in use with {EMULATED.file}\n"


def test_a_cell_file_that_is_put_right_is_taken_at_once(tmp_path: Path) -> None:
    """The mistakes are printed once, by one container; no container has to be started again."""
    file, folder = tmp_path / "mine.yaml", tmp_path / "in-use"
    folder.mkdir()
    text = SIM.file.read_text("utf-8")
    file.write_text(text.replace("rates:", "rate:"), "utf-8")
    with process(folder, file, "keep", "sim") as sim:
        assert line(sim).startswith(f"sim-cell: {file}: ")
        assert chosen(folder) is None
        file.write_text(text, "utf-8")
        until(lambda: chosen(folder) == Choice("sim", file))


def test_a_process_that_waits_in_vain_prints_the_reason(tmp_path: Path) -> None:
    """Without a profile, each prints the command to start; in another profile, that it waits."""
    assert "start the whole cell" in waiting(tmp_path)
    (tmp_path / "profile").touch()
    assert waiting(tmp_path) == ""
    acquire(tmp_path, REAL)
    assert waiting(tmp_path).startswith("the profile real is in use")


def test_check_names_the_profile_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Zero for the one, and for the other one a sentence."""
    monkeypatch.setattr("common.bus.profile_lock.LOCK_PATIENCE_S", 0.0)
    acquire(tmp_path, SIM)
    assert check(tmp_path, SIM) == 0
    assert capsys.readouterr().err == ""
    assert check(tmp_path, EMULATED) == 1
    assert "first `docker compose down`" in capsys.readouterr().err
    end(announce(tmp_path, "emulated"))
    assert check(tmp_path, SIM) == 0
    announce(tmp_path, "emulated")
    assert check(tmp_path, SIM) == 1
    assert "on standby: the profile emulated replaces" in capsys.readouterr().err


# --- the simulation is replaced -------------------------------------------------------------------


@pytest.mark.processes
@pytest.mark.parametrize("other", [EMULATED, REAL])
@pytest.mark.parametrize("sim_first", [True, False])
def test_a_requested_profile_replaces_the_simulation_in_both_orders(
    tmp_path: Path, other: Choice, *, sim_first: bool
) -> None:
    """Never both: robot and hub of the simulation end first, the hub continues with the other file.

    When the other one has ended with all its processes, the simulation is there again.
    """
    (tmp_path / "profile").touch()
    stays = "import os, time; print(os.readlink(os.environ['LINK']), flush=True); time.sleep(60)"
    command = ("--", sys.executable, "-c", stays)
    os.environ["LINK"] = str(tmp_path / "cell.yaml")
    name = f"{other.profile}-cell"
    sim_keeps = process(tmp_path, SIM.file, "keep", "sim")
    other_keeps = process(tmp_path, other.file, "keep", other.profile)
    with (
        process(tmp_path, SIM.file, "run", *command) as hub,
        process(tmp_path, SIM.file, "run", "sim", *command) as robot,
        process(tmp_path, SIM.file, "run", "emulated", "real", *command) as gateway,
        sim_keeps if sim_first else other_keeps as first,
    ):
        if sim_first:
            assert line(first) == f"sim-cell: in use with {SIM.file}\n"
            assert (file_printed_by(hub), file_printed_by(robot)) == (str(SIM.file), str(SIM.file))
        else:
            assert file_printed_by(gateway) == str(other.file)
        with other_keeps if sim_first else sim_keeps as second:
            asked = second if sim_first else first
            assert line(asked) == f"{name}: in use with {other.file}\n"
            assert file_printed_by(hub) == str(other.file)
            if sim_first:
                assert file_printed_by(gateway) == str(other.file)
                assert "ends: the profile" in line(robot)
            sim = first if sim_first else second
            assert line(sim).startswith(f"sim-cell: on standby: the profile {other.profile}")
            for ended in (asked, gateway):
                ended.kill()
            if sim_first:
                # The hub holds on to what it runs with: it is the other cell until it has ended.
                assert chosen(tmp_path) == other


def file_printed_by(process: subprocess.Popen[str]) -> str:
    """Return the next line that a command has printed."""
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_wrong_words_show_the_right_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 and the page of usage."""
    for words in ([], ["keep"], ["keep", "simulated"], ["run", "sim"], ["run", "--"]):
        assert main(words, tmp_path) == 2
        assert "common.bus.profile_lock keep PROFILE" in capsys.readouterr().err

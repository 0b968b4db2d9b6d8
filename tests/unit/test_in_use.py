"""One cell has one cell file: who says which, who waits for it, who is refused and how."""

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

from common.config import load_cell
from common.in_use import (
    PATIENCE_S,
    PLAYERS,
    Choice,
    check,
    chosen,
    claim,
    hold,
    main,
    misfit,
    waiting,
)

ROOT = Path(__file__).resolve().parents[2]
CELLS = ROOT / "cells"
SIM = Choice("sim", CELLS / "demo.yaml")
EMULATED = Choice("emulated", CELLS / "emulated.yaml")
LONG_S = 10.0


def end(lock: int | None) -> None:
    """End the process that has a lock."""
    assert lock is not None
    os.close(lock)


def until(what: Callable[[], object]) -> None:
    """Wait until something is so."""
    give_up_s = time.monotonic() + LONG_S
    while not what():
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


@contextmanager
def process(
    folder: Path, file: Path, *words: str, patience_s: float = PATIENCE_S
) -> Iterator[subprocess.Popen[str]]:
    """Run the module in a process of its own, with its volume at `folder`."""
    start = (
        f"from common import in_use; in_use.PATIENCE_S = {patience_s}; "
        f"in_use.main({list(words)!r}, Path({str(folder)!r}))"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", f"from pathlib import Path; {start}"],
        cwd=ROOT, env={**os.environ, "FORCEMESH_CELL": str(file)}, text=True,
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
    """Return the next line that a process says to people."""
    assert of.stderr is not None
    return of.stderr.readline()


# --- the lock -------------------------------------------------------------------------------------


def test_nothing_is_in_use_before_a_profile_says_its_cell_file(tmp_path: Path) -> None:
    """Who waits has nothing to take part in yet."""
    assert chosen(tmp_path) is None
    assert hold(tmp_path, ()) is None


@pytest.mark.parametrize("profiles", [(), ("sim",), ("emulated", "sim")])
def test_what_a_profile_says_is_in_use_for_all_that_may_be_in_it(
    tmp_path: Path, profiles: tuple[str, ...]
) -> None:
    """The link leads to the cell file, for any process and for those of the profile."""
    claim(tmp_path, SIM)
    assert hold(tmp_path, profiles) is not None
    assert (tmp_path / "cell.yaml").resolve() == SIM.file


def test_a_container_of_another_profile_does_not_take_part(tmp_path: Path) -> None:
    """What plays the robot in one profile stays out of every other one."""
    claim(tmp_path, SIM)
    assert hold(tmp_path, ("emulated", "real")) is None


@pytest.mark.parametrize(
    "other", [EMULATED, Choice("sim", EMULATED.file), Choice("real", SIM.file)]
)
def test_another_choice_is_refused_while_anybody_runs(tmp_path: Path, other: Choice) -> None:
    """One process of the cell is enough; the container that said it may be gone."""
    said = claim(tmp_path, SIM)
    runs = hold(tmp_path, ())
    end(said)
    assert claim(tmp_path, other) is None
    assert chosen(tmp_path) == SIM
    end(runs)
    assert claim(tmp_path, other) is not None
    assert chosen(tmp_path) == other


def test_the_same_choice_may_come_again(tmp_path: Path) -> None:
    """A profile's container that is started anew goes on where it was."""
    claim(tmp_path, SIM)
    assert claim(tmp_path, SIM) is not None


def test_whoever_runs_at_the_same_time_has_the_same_cell_file(tmp_path: Path) -> None:
    """Two profiles and five processes start in any order: all that get to run agree."""
    for _ in range(50):
        locks: list[int] = []
        seen: list[Choice | None] = []

        def start(
            what: Callable[[], int | None], locks: list[int] = locks, seen: list[Any] = seen
        ) -> None:
            if (lock := what()) is not None:
                seen.append(chosen(tmp_path))
                locks.append(lock)

        starts = [partial(claim, tmp_path, each) for each in (SIM, EMULATED)]
        starts += [partial(hold, tmp_path, ()) for _ in range(5)]
        threads = [threading.Thread(target=start, args=(each,)) for each in starts]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert seen
        assert set(seen) == {chosen(tmp_path)}
        for lock in locks:
            os.close(lock)


# --- the processes --------------------------------------------------------------------------------


def test_a_process_starts_when_the_cell_file_is_there_and_holds_it_until_it_ends(
    tmp_path: Path,
) -> None:
    """It waits, becomes its command with the lock in hand, and its end gives the lock back."""
    waits = (
        "run",
        "--",
        sys.executable,
        "-c",
        "import time; print('runs', flush=True); time.sleep(60)",
    )
    with process(tmp_path, SIM.file, *waits, patience_s=0.0) as service:
        assert "waits: no cell file is in use" in line(service)
        end(claim(tmp_path, SIM))
        assert service.stdout is not None
        assert service.stdout.readline() == "runs\n"
        assert claim(tmp_path, EMULATED) is None
    end(claim(tmp_path, EMULATED))


def test_a_refused_profile_says_so_once_and_follows_when_the_other_has_ended(
    tmp_path: Path,
) -> None:
    """One sentence with the way out, no loop; then it is the one in use."""
    with process(tmp_path, SIM.file, "keep", "sim") as sim:
        assert line(sim) == f"sim-cell: in use with {SIM.file}\n"
        with process(tmp_path, EMULATED.file, "keep", "emulated") as emulated:
            assert line(emulated) == (
                f"emulated-cell: the profile sim is in use with {SIM.file}, and one cell has one "
                "profile and one file: first `docker compose --profile sim down`, or take this one "
                "back: `docker compose --profile emulated rm -s -f emulated-cell`\n"
            )
            sim.kill()
            assert line(emulated) == f"emulated-cell: in use with {EMULATED.file}\n"


def test_a_cell_file_that_is_put_right_is_taken_at_once(tmp_path: Path) -> None:
    """The mistakes are said once, by one container; nobody has to start anything again."""
    file, folder = tmp_path / "mine.yaml", tmp_path / "in-use"
    folder.mkdir()
    text = SIM.file.read_text("utf-8")
    file.write_text(text.replace("rates:", "rate:"), "utf-8")
    with process(folder, file, "keep", "sim") as sim:
        assert line(sim).startswith(f"sim-cell: {file}: ")
        assert chosen(folder) is None
        file.write_text(text, "utf-8")
        until(lambda: chosen(folder) == Choice("sim", file))


def test_who_waits_in_vain_says_why(tmp_path: Path) -> None:
    """Without any profile all say what to start; what another profile keeps out says that."""
    assert "start one profile" in waiting(tmp_path)
    (tmp_path / "profile").touch()
    assert waiting(tmp_path) == ""
    claim(tmp_path, SIM)
    assert waiting(tmp_path).startswith("the profile sim is in use")


def test_the_healthcheck_tells_which_profile_is_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Zero for the one, and for the other one a sentence."""
    monkeypatch.setattr("common.in_use.PATIENCE_S", 0.0)
    claim(tmp_path, SIM)
    assert check(tmp_path, SIM) == 0
    assert capsys.readouterr().err == ""
    assert check(tmp_path, EMULATED) == 1
    assert "first `docker compose --profile sim down`" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [[], ["keep"], ["keep", "simulated"], ["run", "sim"], ["run", "--"]]
)
def test_wrong_words_show_the_right_ones(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 and the page of usage."""
    assert main(words, tmp_path) == 2
    assert "common.in_use keep PROFILE" in capsys.readouterr().err


# --- which cell file fits -------------------------------------------------------------------------


@pytest.mark.parametrize("profile", PLAYERS)
@pytest.mark.parametrize("file", ["demo.yaml", "emulated.yaml", "demo-netft.yaml", "demo-tcp.yaml"])
def test_a_profile_takes_only_a_cell_file_whose_players_it_starts(profile: str, file: str) -> None:
    """Robot and sensor of the file are containers of the profile, or one sentence says so."""
    roles = load_cell(CELLS / file).roles
    own = {"sim": ("sim", "sim")}.get(profile, ("gateway", "driver"))
    complaint = misfit(Choice(profile, CELLS / file))
    assert (complaint == "") == ((roles.robot, roles.sensor) == own)
    if complaint:
        assert "take another profile" in complaint
        assert "\n" not in complaint


def test_without_a_cell_file_the_real_profile_says_how_to_name_one() -> None:
    """CELL is required there, and one sentence says how it is given."""
    assert misfit(Choice("real", CELLS)) == (
        "the profile real needs a cell file of yours, one in cells/: "
        "CELL=my-cell.yaml docker compose --profile real up"
    )


def test_a_file_that_is_not_there_is_named_with_those_that_are() -> None:
    """A typing error in CELL gets the list of the cell files."""
    complaint = misfit(Choice("real", CELLS / "dem.yaml"))
    assert "no such file; there are" in complaint
    assert "demo.yaml" in complaint

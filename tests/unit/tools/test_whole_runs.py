"""Runs too long for CI: the kept record of one, and its age limit."""

import json
import subprocess
from pathlib import Path

import pytest

from tools import whole_runs
from tools.tree import ROOT
from tools.whole_runs import WholeRun, defect, failures, git, keep, kept_at

PRINTS_42 = WholeRun("echo 42", ("code",))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A repository with one commit."""
    git("init", "-q", root=tmp_path)
    git("config", "user.name", "tester", root=tmp_path)
    git("config", "user.email", "tester@localhost", root=tmp_path)
    commit(tmp_path, "code/first")
    return tmp_path


def commit(root: Path, name: str, text: str = "") -> None:
    """Commit one file."""
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(text or name)
    git("add", "-A", root=root)
    git("commit", "-qm", name, root=root)


def test_a_kept_run_has_its_command_its_commit_and_its_result(root: Path) -> None:
    """The whole record."""
    assert keep("one", root, PRINTS_42) == 0
    record = json.loads((root / "docs/runs/one.json").read_text())
    assert record["command"] == "echo 42"
    assert git("rev-parse", "HEAD", root=root).startswith(record["commit"])
    assert (record["exit_code"], record["printed"]) == (0, ["42"])
    assert defect("one", root, PRINTS_42) == ""


def test_the_arguments_of_make_do_not_reach_the_run(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`make whole-runs ARGS="keep one"` would else call the run's own make with these ARGS."""
    monkeypatch.setenv("MAKEFLAGS", "-- ARGS=keep\\ one")
    assert keep("one", root, WholeRun("printenv MAKEFLAGS", ("a.py",))) == 1


def test_a_run_of_a_tree_with_changes_is_of_no_commit(root: Path) -> None:
    """No command runs, no file is written."""
    (root / "code/first").write_text("changed")
    assert keep("one", root, PRINTS_42) == 2
    assert not (root / "docs").exists()


def test_a_run_that_failed_is_kept_and_reported(root: Path) -> None:
    """No one can lose it by not committing a green one."""
    failing = WholeRun("false", ("code",))
    assert keep("one", root, failing) == 1
    assert "failed at" in defect("one", root, failing)
    assert not list(failures(root, {"one": failing}))


def test_an_allowed_failure_is_reported_and_does_not_bind(root: Path) -> None:
    """It gets old like any other."""
    failing = WholeRun("false", ("code",), "the day is longer")
    keep("one", root, failing)
    assert defect("one", root, failing) == ""
    (text,) = failures(root, {"one": failing, "none": failing})
    assert "one: FAILED" in text
    assert "may until the day is longer" in text
    for n in range(41):
        commit(root, "code/first", f"version {n}")
    assert "41 commits" in defect("one", root, failing)


def test_no_run_at_all_and_one_of_another_command_are_reported(root: Path) -> None:
    """A row without its file; a row whose command has changed since."""
    assert "no run is kept" in defect("one", root, PRINTS_42)
    keep("one", root, PRINTS_42)
    assert "kept of `echo 42`" in defect("one", root, WholeRun("echo 43", ("code",)))


@pytest.mark.parametrize(("more", "is_old"), [(40, False), (41, True)])
def test_more_than_forty_commits_on_its_subject_make_it_old(
    root: Path, more: int, is_old: bool
) -> None:
    """Commits on other files do not count."""
    keep("one", root, PRINTS_42)
    for n in range(more):
        commit(root, "code/first", f"version {n}")
    commit(root, "elsewhere")
    text = defect("one", root, PRINTS_42)
    assert bool(text) == is_old
    assert ("41 commits touched code" in text) == is_old


def test_where_history_was_rewritten_the_commit_that_brought_it_counts(root: Path) -> None:
    """An unknown commit is no exception: the count starts where the run came in."""
    keep("one", root, PRINTS_42)
    path = root / "docs/runs/one.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"commit": "0123456789"}))
    commit(root, "elsewhere")
    for n in range(41):
        commit(root, "code/first", f"version {n}")
    assert "41 commits" in defect("one", root, PRINTS_42)


def test_where_none_is_kept_everything_is_new(root: Path) -> None:
    """A sample of mutants then takes as much of every module."""
    first = git("rev-parse", "HEAD", root=root)
    commit(root, "code/first", "version 1")
    assert kept_at("one", root) == first
    keep("one", root, PRINTS_42)
    assert git("rev-parse", "HEAD", root=root).startswith(kept_at("one", root))


def test_every_path_of_the_table_is_there_and_every_command_a_target() -> None:
    """A path that has gone would never be touched again."""
    for run in whole_runs.RUNS.values():
        command = ["make", "-n", *run.command.split()[1:]]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, check=False)
        assert done.returncode == 0, run.command
        for path in run.about:
            assert (ROOT / path).exists(), path

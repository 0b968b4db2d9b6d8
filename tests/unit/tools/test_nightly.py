"""`make nightly`: a journal that is never lost or flattered, and parts that exist."""

import importlib.util
from pathlib import Path

import pytest

from tools import nightly
from tools.nightly import MOST_S, PARTS, Part, Result, read, run, run_all

GOOD = Part("python -m timeit -n 1 pass", 0.1)
BAD = Part("python -m timeit -n 1 raise", 0.1)


def test_a_part_with_a_result_is_not_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Neither one that passed nor one that failed; one without a result is run."""
    journal = tmp_path / "out" / "journal.jsonl"
    parts = {"bad": BAD, "good": GOOD, "later": GOOD}
    assert run_all(["bad"], journal, parts) == 1
    first = journal.read_text()
    assert run_all(["bad", "good"], journal, {**parts, "bad": GOOD}) == 1
    assert journal.read_text().startswith(first)
    assert list(read(journal)) == ["bad", "good"]
    printed = capsys.readouterr().out
    assert "1 of 2 parts to run, about 0 minutes: good" in printed
    assert "FAILED (1)" in printed
    assert "passed" in printed


def test_an_interrupted_part_has_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The next run starts it again."""
    journal = tmp_path / "journal.jsonl"

    def interrupt(name: str, part: Part) -> Result:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(nightly, "run", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run_all(["good"], journal, {"good": GOOD})
    assert read(journal) == {}
    assert run_all(["good"], journal, {"good": GOOD}) == 0


def test_a_part_is_ended_after_its_time():
    """Its exit code is that of `timeout`, and not that of success."""
    assert (
        run("endless", Part("python -m timeit -n 9999999999 pass", 1), most_s=0.5).exit_code == 124
    )


def test_the_end_of_the_output_is_in_the_journal():
    """With the reason of a failure."""
    result = run("fails", BAD)
    assert result.exit_code == 1
    assert "RuntimeError: No active exception to reraise" in result.printed


@pytest.mark.parametrize("name", PARTS)
def test_each_part_exists_and_takes_at_most_90_minutes(name: str):
    """A module that can be found, and files that are there."""
    words = PARTS[name].command.split()
    assert PARTS[name].minutes * 60 <= MOST_S
    if words[:2] == ["python", "-m"]:
        assert importlib.util.find_spec(words[2]) is not None
    for word in words:
        if word.startswith(("tests/", "tools/")):
            assert Path(word).exists()


def test_an_unknown_part_is_named(monkeypatch: pytest.MonkeyPatch, capsys):
    """With those that exist."""
    monkeypatch.setattr("sys.argv", ["nightly", "nothing"])
    with pytest.raises(SystemExit):
        nightly.main()
    assert "no part nothing; there are long" in capsys.readouterr().err

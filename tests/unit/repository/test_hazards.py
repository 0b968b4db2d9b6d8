"""docs/hazards.md: every hazard has a row with its proof, which `python -m tests.hazards` tries."""

import ast
import re
from pathlib import Path

import pytest

from tests import hazards
from tests.hazards import FAILED, NO_CHANGE, PAGE, PASSED, Planted, named_tests, planted, rows
from tools.nightly import parts_of
from tools.tree import ROOT


def test_every_hazard_has_one_row_and_every_command_exists() -> None:
    """H01 to H55, as the analysis numbers them; each named command is a target of make."""
    page = PAGE.read_text(encoding="utf-8")
    found = re.findall(r"^\| (H\d\d) \|", page, re.MULTILINE)
    assert sorted(found) == [f"H{number:02d}" for number in range(1, 56)]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"`make ([a-z-]+)`", page)):
        assert f"\n{target}:" in makefile, target


@pytest.mark.parametrize("hazard", rows())
def test_a_row_has_a_planted_change_that_fits_or_the_reason_why_not(hazard: str) -> None:
    """The changed file can be compiled, and each test that must find the change exists."""
    changes = [change for change in planted() if change.hazard == hazard]
    proof = rows()[hazard]
    assert bool(changes) != bool(NO_CHANGE.search(proof))
    assert bool(changes) == bool(named_tests(proof))
    for change in changes:
        text = change.fitted(ROOT)
        if change.file.endswith(".py"):
            ast.parse(text)
    for file, _, function in (test.partition("::") for test in named_tests(proof)):
        assert not function or f"def {function}(" in (ROOT / file).read_text(encoding="utf-8"), (
            function
        )


def test_every_command_that_is_named_is_a_part_of_the_nightly_run() -> None:
    """A reader can run each of them."""
    page = PAGE.read_text(encoding="utf-8")
    named = set(re.findall(r"`make nightly ARGS=([a-z-]+)`", page))
    assert named
    assert {name for name in named if not parts_of(name)} == set()
    assert not re.search(r"`make (?!nightly ARGS=)", page)


def test_only_a_failed_test_is_a_proof_and_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1 while one passes or cannot run; what was found is in the journal."""
    file, control = "forcemesh/reader.py", "elif header.seq <= last.seq:"
    path = tmp_path / file
    path.parent.mkdir()
    path.write_text(text := (ROOT / file).read_text(encoding="utf-8"), encoding="utf-8")
    found = {text: PASSED, f"# {text}": PASSED, text.replace(control, "elif False:"): FAILED}
    runs: list[int] = []

    def verdict(_folder: Path, _tests: list[str], **_: str) -> int:
        runs.append(found.get(path.read_text(encoding="utf-8"), 2))
        return runs[-1]

    monkeypatch.setattr(hazards, "verdict", verdict)
    changes = [Planted("H14", file, text, new) for new in (f"# {text}", *list(found)[2:], "(")]
    for _ in range(2):
        journal = hazards.Journal(tmp_path / "out" / "journal.jsonl")
        assert hazards.run(changes, journal, tmp_path) == 1
    assert runs == [PASSED, PASSED, FAILED, 2, PASSED, 2]
    printed = capsys.readouterr().out
    assert printed.count("NOT FOUND: H14") == printed.count("NO VERDICT") == 2
    assert "1 of 3 planted changes are found" in printed

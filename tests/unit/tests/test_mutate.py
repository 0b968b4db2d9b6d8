"""The judge of the tests: it makes its listed changes, and detects whether a test fails."""

import multiprocessing
import subprocess
import sys
from pathlib import Path

import pytest

from tests import mutate, mutations
from tests.mutations import Changes, Mutant

TEXT = '''"""A module."""
MARGIN = 1.5
TABLE = (
    "first",
    "second",
)


def allowed(value: float, limit: float = 2.0) -> bool:
    """Compare."""
    if not value:
        note(value)
    return value <= MARGIN * limit and value is not None


def text(value: float) -> str:
    """Texts for people stay as they are."""
    return f"{value * 1e3:.1f} mm"
'''


def judged(mutant: Mutant, within_s: float) -> bool:
    """Judge it from a process that has imported nothing, as `python -m tests.mutate` does."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(mutate.forked, (mutant, within_s))[0]


def made() -> dict[str, str]:
    """The changes of the text, each as the line that it makes of one."""
    lines = TEXT.splitlines()
    return {
        each.name: next(
            new for old, new in zip(lines, each.text.splitlines(), strict=False) if old != new
        ).strip()
        for each in Changes("planted", TEXT)
    }


def test_every_kind_of_change_is_made_once_and_nothing_else():
    """Limits, rows, comparisons, bypasses of a function; neither types, defaults nor texts."""
    assert made() == {
        "module: 1.5 in MARGIN = 1.5 -> 2.4": "MARGIN = 2.4",
        "module: 1.5 in MARGIN = 1.5 -> 0.15": "MARGIN = 0.15",
        'module: "first" left out': "",
        'module: "second" left out': "",
        "allowed: returns None": "return None",
        "allowed: not value not left out": "if value:",
        "allowed: note(value) in note(value) -> pass": "pass",
        "allowed: value <= MARGIN * limit and value is not None -> or": (
            "return value <= MARGIN * limit or value is not None"
        ),
        "allowed: value <= MARGIN * limit -> <": (
            "return value < MARGIN * limit and value is not None"
        ),
        "allowed: value <= MARGIN * limit -> >": (
            "return value > MARGIN * limit and value is not None"
        ),
        "allowed: MARGIN * limit -> /": "return value <= MARGIN / limit and value is not None",
        "allowed: value is not None -> is": "return value <= MARGIN * limit and value is None",
        "text: returns None": "return None",
    }


def test_the_changes_that_must_never_live_are_among_them():
    """A sign check that a fifth of a touch passes, loose margins, a guard or a row left out."""
    titles = {each.title for module in mutations.JUDGES for each in mutations.mutants_of(module)}
    expected = (
        "services.regulator.guards module: 0.7 in MAIN_PART = 0.7 -> 0.07",
        "common.motion.setpoint_monitor module: 1.25 in SPEED_MARGIN = 1.25 -> 2",
        "common.motion.last_check LastCheck.setpoint: returns None",
        "services.regulator.guards _first_touch: returns None",
    )
    assert titles.issuperset(expected)
    rows = [title for title in titles if title.startswith("services.arbiter.preflight module: Che")]
    assert len(rows) == 12


def test_a_module_of_the_table_and_its_judges_are_there():
    """No judge is a file that has gone."""
    for module in mutations.JUDGES:
        assert mutations.path_of(module).is_file(), module
        for judge in mutations.judges_of(module):
            assert (mutations.ROOT / judge).is_file(), judge


def test_a_change_that_a_test_notices_is_killed_and_one_that_changes_nothing_lives():
    """In a process of its own, with the text in the module's place."""
    module = "services.wrench.calibration_manager"
    text = mutations.path_of(module).read_text()
    same = Mutant(module, "another comment", f"{text}\n# nothing\n")
    dead = next(each for each in mutations.mutants_of(module) if each.name.endswith("returns None"))
    assert not judged(same, 300.0)
    assert judged(dead, 300.0)


def test_a_mutant_that_hangs_is_killed():
    """A loop without end is noticed by its time."""
    module = "services.wrench.calibration_manager"
    text = mutations.path_of(module).read_text()
    assert judged(Mutant(module, "hangs", f"while True: pass\n{text}"), 2.0)


def test_a_module_that_is_imported_already_cannot_be_judged(monkeypatch: pytest.MonkeyPatch):
    """Its tests would see the module as it is, and every change of it would live."""
    monkeypatch.setitem(sys.modules, "services.wrench.calibration_manager", sys)
    with pytest.raises(RuntimeError, match="imported already"):
        mutate.forked(Mutant("services.wrench.calibration_manager", "any", ""), 2.0)


def test_only_a_survivor_that_is_not_listed_counts():
    """One that is listed is left alone; one that is listed and killed is reported."""
    first, second, third = (Mutant("m", name, "") for name in ("a", "b", "c"))
    lines: list[str] = []
    results = iter([(first, False), (second, False), (third, True)])
    assert mutate.report(results, {"m a": "why", "m c": "why"}, lines.append) == 1
    assert lines == [
        "SURVIVED m b",
        "killed, and listed as a survivor: m c",
        "1 killed, 1 survived that are not listed",
    ]


def test_a_survivor_is_listed_with_its_reason(tmp_path: Path):
    """The list that ships can be read; a row without a reason is refused."""
    assert all(mutate.listed().values())
    planted = tmp_path / "survivors.txt"
    planted.write_text("# a remark\n\nm f: a < b -> <= | the same to the last bit\n")
    assert mutate.listed(planted) == {"m f: a < b -> <=": "the same to the last bit"}
    planted.write_text("m f: a < b -> <=\n")
    with pytest.raises(ValueError, match="no reason after"):
        mutate.listed(planted)


def test_every_listed_survivor_is_still_a_change_of_its_module():
    """A row whose line has gone would let another change live unseen."""
    titles = {each.title for module in mutations.JUDGES for each in mutations.mutants_of(module)}
    assert set(mutate.listed()) <= titles


def test_a_choice_is_the_same_for_the_same_seed_and_another_for_another_one():
    """So many of each module; all of them where fewer are there."""
    choice = [mutate.chosen(["common.motion.permission"], 5, seed) for seed in (1, 1, 2)]
    assert len(choice[0]) == 5
    assert choice[0] == choice[1] != choice[2]
    assert len(mutate.chosen(["services.wrench.calibration_manager"], 999, 1)) == len(
        mutations.mutants_of("services.wrench.calibration_manager")
    )


def test_a_module_or_its_judges_that_were_touched_are_changed(monkeypatch):
    """Paths in the form of git."""
    touched = "tests/unit/controller/test_packet.py\ncommon/security/access_control.py\nREADME.md\n"
    done = subprocess.CompletedProcess([], 0, touched)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    assert mutate.changed_since("a0") == [
        "controller.packet",
        "controller.packet_table",
        "common.security.access_control",
    ]


def test_the_command_judges_a_choice_and_names_a_module_that_it_does_not_know():
    """As `python -m tests.mutate` calls it, with everything imported that it imports beforehand."""
    command = [sys.executable, "-m", "tests.mutate", "--count", "1", "--jobs", "1"]
    known, unknown = (
        subprocess.run(
            [*command, module], cwd=mutations.ROOT, capture_output=True, text=True, check=False
        )
        for module in ("services.wrench.calibration_manager", "common.nothing")
    )
    assert known.returncode == 0, known.stdout + known.stderr
    assert "1 killed, 0 survived" in known.stdout
    assert unknown.returncode == 2
    assert "common.nothing is not in the table" in unknown.stderr

"""Mutation test: it makes its listed changes, and reports which no test detects."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutate import __main__ as mutate
from tests.mutate import mutations, program
from tests.mutate.judge import Verdict
from tests.mutate.mutations import Changes

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
    titles = {each.title for module in mutations.MODULES for each in mutations.mutants_of(module)}
    expected = (
        "control.monitors module: 0.7 in MAIN_PART = 0.7 -> 0.07",
        "common.motion.setpoint_monitor module: 1.25 in SPEED_MARGIN = 1.25 -> 2",
        "common.motion.arm_check ArmCheck.setpoint: returns None",
        "control.monitors first_touch: returns None",
    )
    assert titles.issuperset(expected)
    rows = [title for title in titles if title.startswith("services.arbiter.preflight module: Che")]
    assert len(rows) == 13


def test_only_a_survivor_that_is_not_listed_counts():
    """One that is listed is left alone; one that is listed and killed is reported."""
    found = [Verdict("m a", 1, [], 0), Verdict("m b", 1, [], 0), Verdict("m c", 1, ["t"], 0)]
    assert mutate.report(found, {"m a": "why", "m c": "why"}) == (
        [
            "SURVIVED m b",
            "killed, and listed as a survivor: m c",
            "1 killed, 1 survived that are not listed",
        ],
        1,
    )


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
    titles = {each.title for module in mutations.MODULES for each in mutations.mutants_of(module)}
    assert set(mutate.listed()) <= titles


def test_a_choice_is_the_same_for_the_same_seed_and_another_for_another_one():
    """So many of each module; all of them where fewer are there."""
    choice = [mutate.chosen(["common.motion.permission"], 5, seed) for seed in (1, 1, 2)]
    assert len(choice[0]) == 5
    assert choice[0] == choice[1] != choice[2]
    assert len(mutate.chosen(["services.wrench.calibration_manager"], 999, 1)) == len(
        mutations.mutants_of("services.wrench.calibration_manager")
    )


def test_the_changes_of_the_controllers_program_are_each_of_another_line():
    """As many as asked for, and each is a program that the controller would load."""
    choice = [program.chosen(20, seed) for seed in (1, 1, 2)]
    assert choice[0] == choice[1] != choice[2]
    assert len({mutations.line_of(mutant) for mutant in choice[0]}) == 20


def test_the_command_names_a_module_that_it_does_not_know():
    """The modules that it knows are in the message."""
    command = [sys.executable, "-m", "tests.mutate", "common.nothing"]
    done = subprocess.run(command, cwd=mutations.ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "common.nothing is not in the table: common.motion.arm_check" in done.stderr


def test_a_choice_is_judged_from_the_map_on() -> None:
    """Changes that a test detects; the second time the journal is read."""
    module, tests = (
        "services.wrench.plausibility",
        "tests/unit/services/wrench/test_plausibility.py",
    )
    choice = ["--count", "2", "--seed", "1", "--tests", tests]
    command = [sys.executable, "-m", "tests.mutate", module, *choice]
    first, second = (
        subprocess.run(command, cwd=mutations.ROOT, capture_output=True, text=True, check=False)
        for _ in range(2)
    )
    assert first.returncode == second.returncode == 0, first.stdout + first.stderr
    assert "2 killed, 0 survived" in first.stdout
    assert "2 killed, 0 survived" in second.stdout
    assert f"of 2: {module}" not in second.stderr

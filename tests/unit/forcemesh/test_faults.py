"""The dictionary of faults: complete, unique, documented, and the only source of reasons."""

import ast
from functools import cache
from math import pi
from pathlib import Path

import pytest

from forcemesh.codec import MAX_BYTES, encode_record
from forcemesh.errors import RefusedError
from forcemesh.faults import (
    FAULTS,
    MOST_TEXT_BYTES,
    FaultCode,
    refusal,
    refused,
    trip_text,
    tripped,
)
from tools.tree import production_files

ROOT = Path(__file__).parents[3]
CODE = production_files()
each_fault = pytest.mark.parametrize("fault", FAULTS.values(), ids=lambda fault: fault.code)
KINDS_OF_RULES = {
    1: "which writer is read",
    2: "sensor",
    3: "robot",
    4: "limits",
    5: "who commands",
    6: "recordings",
}


@cache
def every_call() -> list[tuple[Path, ast.Call]]:
    """Every call in the product's code, with its file."""
    return [
        (path, node)
        for path in CODE
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
    ]


def calls(name: str) -> list[tuple[Path, ast.Call]]:
    """Every call of a function or class in the product's code, with its file."""
    return [each for each in every_call() if getattr(each[1].func, "id", "") == name]


def test_rules_are_unique_in_order_and_of_a_known_hundred() -> None:
    """A number that is used twice explains nothing."""
    rules = [fault.rule for fault in FAULTS.values()]
    assert rules == sorted(set(rules))
    assert {rule // 100 for rule in rules} == set(KINDS_OF_RULES)


@each_fault
def test_a_fault_has_cause_and_remedy_in_words(fault: FaultCode) -> None:
    """Short, without a dot at the end, without the words of a safety function."""
    for text in (fault.cause, fault.remedy):
        assert 5 < len(text) < 200
        assert not text.endswith(".")
        assert "|" not in text
        for forbidden in ("e-stop", "emergency", "guarantee", "safe "):
            assert forbidden not in text.lower()


def test_trips_and_refusals_are_made_by_the_dictionary_alone() -> None:
    """No other module makes a Trip, or a Reply that refuses."""
    home = ROOT / "forcemesh" / "faults.py"
    assert {path for path, _ in calls("Trip")} == {home}
    for path, call in calls("Reply"):
        accepted = next((k.value for k in call.keywords if k.arg == "accepted"), None)
        assert isinstance(accepted, ast.Constant)
        assert accepted.value or path == home, f"{path}:{call.lineno}"


def test_every_code_in_the_code_is_a_row_of_the_dictionary() -> None:
    """A misspelt code would be found when it is needed."""
    for name in ("tripped", "refusal", "RefusedError"):
        for path, call in calls(name):
            code = call.args[0]
            if isinstance(code, ast.Constant):
                assert code.value in FAULTS, f"{path}:{call.lineno}"


@cache
def words_of(*patterns: str) -> set[str]:
    """Return every text that stands alone in the files of some patterns, faults.py left out."""
    return {
        node.value
        for pattern in patterns
        for path in ROOT.glob(pattern)
        if path.name not in ("faults.py", "test_faults.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


@each_fault
def test_a_fault_is_raised_by_the_code_and_expected_by_a_test(fault: FaultCode) -> None:
    """A code that nothing causes is a mistake of the dictionary; its cause has a test elsewhere."""
    folders = ("forcemesh", "common", "control", "services", "cli", "controller", "sim")
    assert fault.code in words_of(*(f"{folder}/**/*.py" for folder in folders))
    assert fault.code in words_of("tests/unit/**/test_*.py", "tests/contract/test_*.py")


@each_fault
def test_the_longest_trip_can_be_sent(fault: FaultCode) -> None:
    """Also as a refusal, whatever its text holds; numbers that are not finite are left out."""
    reply = refused(
        tripped(fault.code, "\N{WHITE SMILING FACE}" * 500, value=float("nan"), limit=1.0)
    )
    assert (reply.rule, reply.code, reply.value, reply.limit) == (fault.rule, fault.code, None, 1.0)
    assert len(reply.text.encode()) <= MOST_TEXT_BYTES
    assert len(encode_record(reply)) < MAX_BYTES


def test_a_refusal_is_not_accepted() -> None:
    """With code, rule and number."""
    reply = refusal("speed", "too fast", value=2.0, limit=1.0)
    assert (reply.accepted, reply.code, reply.rule, reply.value) == (False, "speed", 405, 2.0)
    assert RefusedError("speed", "too fast").code == "speed"


@pytest.mark.parametrize(
    ("value", "limit", "unit", "shown"),
    [
        (31.24, 30.0, "N", "it broke (31.24 N, limit 30 N)"),
        (-0.4123, -0.4, "m", "it broke (-412.3 mm, limit -400 mm)"),
        (0.5, 0.25, "m/s", "it broke (500 mm/s, limit 250 mm/s)"),
        (pi, pi / 2, "rad", "it broke (180 deg, limit 90 deg)"),
        (0.2, None, "s", "it broke (0.2 s)"),
        (0.2, 0.1, "", "it broke"),
        (float("inf"), 1.0, "N", "it broke (limit 1 N)"),
    ],
)
def test_a_trip_is_shown_with_its_value_limit_and_unit(value, limit, unit, shown):
    """It is in the units of the pendant; a number without a unit stays in the text."""
    assert trip_text(tripped("force", "it broke", value=value, limit=limit, unit=unit)) == shown

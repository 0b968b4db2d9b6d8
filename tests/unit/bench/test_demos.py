"""Demos during other work: how results are counted, and the right to priority."""

import json
import os
import subprocess
import sys

import pytest

from bench.demos import A_USERS, ROOTS_OWN, outcome

GOOD = {"settled": True, "overshoot_pct": 2.5, "settling_s": 0.12}
ASKS_FOR_PRIORITY = """
import os
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
except PermissionError:
    print("refused")
"""


@pytest.mark.parametrize(
    ("printed", "found"),
    [
        (json.dumps(GOOD), GOOD),
        (json.dumps({"settled": False, "error": "the arm holds"}), "the arm holds"),
        (json.dumps(GOOD | {"settled": False}), "the force did not settle"),
        ("usage: demo\nno such option", "no such option"),
        ("", "no output"),
    ],
)
def test_the_outcome_of_a_demo_is_its_result_or_why_it_did_not_settle(printed, found) -> None:
    """One that held, one that did not settle, one that printed no JSON."""
    assert outcome(printed) == found


def test_without_priority_the_right_to_it_is_gone() -> None:
    """Root has it by a capability, a user by a limit."""
    words = ROOTS_OWN if os.geteuid() == 0 else A_USERS
    command = [*words, sys.executable, "-c", ASKS_FOR_PRIORITY]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout == "refused\n"

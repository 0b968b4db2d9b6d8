"""Ten thousand commands of a hostile arbiter: no excessive command leaves a robot's last check.

`make nightly ARGS=fuzz-commands` sends a million of them.
"""

from pathlib import Path

import pytest

from tests.fuzz import commands, hostile_arbiter
from tests.fuzz.judges import allowance


@pytest.mark.parametrize("robot", ["gateway", "sim"])
def test_no_command_gets_past_the_limits(robot: str) -> None:
    """Workspace, tether, joints, speed, window, acceleration, force; and much of it was obeyed."""
    table = commands.fuzz(robot, 6000, seed=1)
    assert table.broken == {}, table.first_broken
    assert table.obeyed > 200
    assert table.moved_ms > 100
    assert len(table.holds) > 8


@pytest.fixture
def never_backs_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seed 42 has its known result under ordinary leases."""
    monkeypatch.setattr(hostile_arbiter, "PURPOSES", ("all",))


@pytest.mark.usefixtures("never_backs_off")
def test_a_command_that_leaves_late_leaves_within_the_limits() -> None:
    """Seed 42 once commanded what was allowed on arrival and too sudden when it left."""
    assert commands.fuzz("gateway", 5000, seed=42).broken == {}


def test_the_page_lists_the_commands_that_the_judge_lets_pass() -> None:
    """Every command that the judge lets pass is named on the page."""
    page = Path(__file__).parents[4] / "docs" / "reliability.md"
    assert allowance() in page.read_text(encoding="utf-8")

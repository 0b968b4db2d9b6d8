"""Ten thousand commands of an evil arbiter: nothing leaves a robot's last check that is too much.

`make fuzz-commands` says a million of them.
"""

from pathlib import Path
from typing import Any

import pytest

from common.motion.last_check import LastCheck
from common.motion.setpoint_monitor import SetpointMonitor
from services.gateway.setpoint_shaper import SetpointShaper
from tests.fuzz import commands
from tests.fuzz import hostile_arbiter as evil
from tests.fuzz.judges import allowance

AS_IT_CAME = (SetpointShaper, "share")  # of its way that may leave
IN_ONE = (SetpointShaper, "_share_of_step")
ROBOTS = pytest.mark.parametrize("robot", ["gateway", "sim"])


@ROBOTS
def test_no_command_gets_past_the_limits(robot: str) -> None:
    """Workspace, tether, joints, speed, window, acceleration, force; and much of it was obeyed."""
    table = commands.fuzz(robot, 5000, seed=1)
    assert table.broken == {}, table.first_broken
    assert table.obeyed > 200
    assert table.moved_ms > 200
    assert len(table.holds) > 8


@pytest.fixture
def never_backs_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seed 42 says what it is known for under ordinary leases."""
    monkeypatch.setattr(evil, "PURPOSES", ("all",))


@pytest.mark.usefixtures("never_backs_off")
def test_what_is_late_to_leave_leaves_within_the_limits() -> None:
    """Seed 42 once said what was allowed when it came, and was too sudden when it left."""
    assert commands.fuzz("gateway", 5000, seed=42).broken == {}


def test_the_page_says_what_the_judge_lets_pass() -> None:
    """Nothing is let pass of which a reader of the page would not know."""
    page = Path(__file__).parents[4] / "docs" / "reliability.md"
    assert allowance() in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("robot", "without", "breaks"),
    [
        ("gateway", [(SetpointMonitor, "spend"), AS_IT_CAME], "acceleration"),
        ("gateway", [(LastCheck, "setpoint"), AS_IT_CAME, IN_ONE], "workspace"),
        ("gateway", [(LastCheck, "wrench")], "moved without leave"),
        ("sim", [(LastCheck, "setpoint"), (LastCheck, "arm")], "workspace"),
        ("sim", [(LastCheck, "wrench")], "force"),
    ],
)
def test_the_judge_sees_what_the_guard_keeps_back(
    monkeypatch: pytest.MonkeyPatch, robot: str, without: list[tuple[Any, str]], breaks: str
) -> None:
    """Without one of its rules a limit is broken, or the test above proves nothing."""
    for where in without:
        allowed = 1.0 if where in (AS_IT_CAME, IN_ONE) else None
        monkeypatch.setattr(*where, lambda *_, allowed=allowed, **__: allowed)
    assert any(breaks in commands.fuzz(robot, 2500, seed=seed).broken for seed in (2, 1))

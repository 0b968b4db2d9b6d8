"""State that the monitors keep over a change of set point or mode. Pure."""

from typing import Any

import pytest

from forcemesh.messages import ZERO3
from services.regulator.guards import GuardState, HalfWaves, kept_over_restart
from tests.fakes.guard_steps import guard_sample


@pytest.mark.parametrize(
    ("first", "touched", "present", "lives_on"),
    [
        ("approach", False, "approach", False),
        ("free", False, "free", False),
        ("approach", True, "contact", True),
        ("approach", True, "approach", True),
        ("contact", True, "contact", True),
        ("contact", True, "free", False),
        ("contact", True, "approach", False),
        ("free", True, "approach", False),
    ],
)
def test_a_change_of_set_point_keeps_the_budgets_of_a_press(
    first: Any, touched: bool, present: Any, lives_on: bool
) -> None:
    """Budgets continue from the first touch; a press begun in contact and now free starts anew."""
    before = GuardState(
        first=guard_sample(first),
        began_free=first == "approach",
        worked=guard_sample(present),
        touched=touched,
        found=True,
        environment_work_J=0.02,
        tool_work_J=0.03,
        p_search_m=ZERO3,
        swing=[HalfWaves(count=9) for _ in range(6)],
    )
    now = kept_over_restart(before)
    kept = (now.first, now.worked, now.touched, now.environment_work_J, now.tool_work_J)
    same = (before.first, before.worked, True, 0.02, 0.03)
    assert kept == (same if lives_on else (None, None, False, 0.0, 0.0))
    assert (now.found, now.p_search_m) == (False, None)
    assert now.swing == [HalfWaves()] * 6
    assert now.yielding is before.yielding


def test_a_change_before_the_first_sample_carries_nothing() -> None:
    """After two requests within one period no motion has occurred."""
    now = kept_over_restart(GuardState())
    nothing = (None, None, False, False, False, False, 0.0, 0.0)
    assert (
        now.first,
        now.worked,
        now.began_free,
        now.touched,
        now.verified,
        now.found,
        now.environment_work_J,
        now.tool_work_J,
    ) == nothing

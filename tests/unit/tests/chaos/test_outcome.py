"""Bounds of an injected fault: who has to report what."""

import pytest

from tests.chaos.cases import Case, FailureKind
from tests.chaos.outcome import Outcome, OutcomeLimits, violations

LIMITS = OutcomeLimits(command_s=0.1, watchdog_s=0.0, speed_m_s=0.25)


@pytest.mark.parametrize(
    ("kind", "seed", "second"),
    [("kill", 8, ""), ("two-killed", 8, "arbiter"), ("two-killed", 7, "regulator")],
)
def test_a_cause_is_reported_and_the_status_shows_it(
    kind: FailureKind, seed: int, second: str
) -> None:
    """Robot and arbiter that end together leave nobody with a cause: the status shows them."""
    case = Case("sim", "robot", kind, "press", seed)
    assert case.second_role == second
    by_status_alone = [] if second == "arbiter" else ["nothing named a cause"]
    for causes, shows, broken in (
        (["stale"], True, []),
        (["stale"], False, ["forcemesh status did not show it"]),
        ([], True, by_status_alone),
    ):
        outcome = Outcome(case, arm_ended=True, causes=causes, status_shows=shows)
        assert violations(outcome, LIMITS) == broken
    assert violations(Outcome(case, arm_ended=True), LIMITS) != []

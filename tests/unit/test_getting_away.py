"""Out of too much force: the ceilings come down with what is felt, and no way leads back in."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.getting_away import EASE, check_way_out, eased
from common.guard import Guard
from common.limits import Limits, check_wrench
from common.messages import Vec3, WrenchAtTcp
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL

LIMITS = Limits.of(CELL)
NOTHING = np.zeros(3)
TOO_MUCH_N = 1.5 * LIMITS.force_N
parts = st.floats(-200.0, 200.0)
vectors = st.tuples(parts, parts, parts).map(np.array)


@given(st.lists(st.tuples(vectors, vectors), min_size=1, max_size=20))
def test_ceilings_only_come_down_and_end_at_the_cells(felt) -> None:
    """Whatever is felt: never above the last ones, never below the cell's."""
    now = eased(LIMITS, *felt[0])
    assert check_wrench(now, *felt[0]) is None
    for force_N, torque_Nm in felt:
        before, now = now, eased(LIMITS, force_N, torque_Nm, now)
        assert LIMITS.force_N <= now.force_N <= before.force_N
        assert LIMITS.torque_Nm <= now.torque_Nm <= before.torque_Nm
    now = eased(LIMITS, NOTHING, NOTHING, now)
    assert (now.force_N, now.torque_Nm) == (LIMITS.force_N, LIMITS.torque_Nm)


@given(vectors, vectors)
def test_below_the_ceilings_every_way_is_free_above_them_none_leads_back_in(force_N, way_m) -> None:
    """Also where nobody knows where the tool goes."""
    trip = check_way_out(LIMITS, force_N, NOTHING, way_m)
    if np.linalg.norm(force_N) <= LIMITS.force_N:
        assert trip is None
        assert check_way_out(LIMITS, force_N, NOTHING, None) is None
        return
    assert check_way_out(LIMITS, force_N, NOTHING, None) is not None
    assert check_way_out(LIMITS, force_N, NOTHING, 1e-3 * force_N) is None
    assert check_way_out(LIMITS, force_N, NOTHING, -1e-3 * force_N) is not None
    if way_m @ force_N <= 0.0:
        assert trip is not None
        assert trip.code == "force"


def up_N(force_N: float) -> WrenchAtTcp:
    """Return what pushes the tool up."""
    return WrenchAtTcp(force_N=(0.0, 0.0, force_N))


def test_the_robots_own_check_lets_an_arm_get_away_and_no_further_in() -> None:
    """Under a lease for jog alone; each newton that was got rid of counts."""
    guard = Guard(CELL)
    guard.start(T_START, "jog")
    assert guard.wrench(up_N(TOO_MUCH_N)) is None
    assert guard.wrench(up_N(EASE * TOO_MUCH_N - 0.01)) is None
    assert guard.wrench(up_N(EASE * TOO_MUCH_N + 0.01)) is not None
    assert guard.wrench(up_N(0.9 * TOO_MUCH_N)) is None
    assert guard.wrench(up_N(TOO_MUCH_N)) is not None
    assert guard.wrench(up_N(0.0)) is None
    assert guard.wrench(up_N(LIMITS.force_N + 0.01)) is not None


@pytest.mark.parametrize("force_N", [(float("nan"), 0.0, 0.0), (float("inf"), 0.0, 0.0)])
def test_what_is_no_number_eases_nothing(force_N: Vec3) -> None:
    """Refused, and the next reading counts as before."""
    guard = Guard(CELL)
    guard.start(T_START, "jog")
    bad = WrenchAtTcp.model_construct(force_N=force_N, torque_Nm=(0.0, 0.0, 0.0))
    assert guard.wrench(up_N(0.0)) is None
    assert guard.wrench(bad) is not None
    assert guard.wrench(up_N(TOO_MUCH_N)) is not None


def test_a_lease_for_force_eases_nothing() -> None:
    """Neither does the next one after a lease for jog."""
    guard = Guard(CELL)
    for purpose in ("all", "jog", "all"):
        guard.start(T_START, purpose)
        trip = guard.wrench(up_N(TOO_MUCH_N))
        assert (trip is None) == (purpose == "jog")

"""The model of the way from a command to the force: lag, delay, what it may never do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from services.regulator.delay_model import DelayModelSettings, at_rest, follow

DT_S = 0.004
vectors = hnp.arrays(float, 3, elements=st.floats(-0.01, 0.01))
ways = st.builds(
    DelayModelSettings,
    delay_s=st.floats(0.0, 0.06),
    lag_s=st.floats(0.001, 0.03),
    filter_s=st.floats(0.0, 0.01),
    median_s=st.just(0.0),
)


def run(commands, settings, dt_s=DT_S):
    """Follow commands from rest at the first one; return every state."""
    states = [at_rest(commands[0])]
    for command in commands[1:]:
        states.append(follow(states[-1], command, dt_s, settings))
    return states


@given(ways, vectors)
def test_a_command_that_holds_is_felt_as_it_is(settings, command) -> None:
    """Nothing moves, so nothing is on its way."""
    end = run([command] * 30, settings)[-1]
    assert end.filtered == pytest.approx(command, abs=1e-15)
    assert end.acceleration == pytest.approx(np.zeros(3), abs=1e-9)


@given(ways, st.lists(vectors, min_size=2, max_size=40))
def test_what_is_felt_lies_between_what_was_commanded(settings, commands) -> None:
    """A way without overshoot: no axis leaves the range of its commands."""
    low, high = np.min(commands, axis=0), np.max(commands, axis=0)
    for state in run(commands, settings):
        assert (state.filtered >= low - 1e-15).all()
        assert (state.filtered <= high + 1e-15).all()


@given(ways, st.lists(vectors, min_size=2, max_size=40), vectors)
def test_the_way_does_not_depend_on_where_it_is(settings, commands, offset) -> None:
    """Moving every command by the same vector moves what is felt by it, and no more."""
    here = run(commands, settings)[-1]
    there = run([command + offset for command in commands], settings)[-1]
    assert there.filtered - here.filtered == pytest.approx(offset, abs=1e-12)
    assert there.acceleration == pytest.approx(here.acceleration, abs=1e-6)


@given(ways)
def test_an_even_motion_is_felt_by_the_sum_of_all_delays_later(settings) -> None:
    """Delay, lag and filter add up; half a period more, as commands hold until the next one."""
    speed = np.array([0.0, 0.01, -0.02])
    end = run([speed * DT_S * step for step in range(150)], settings)[-1]
    late_s = settings.delay_s + settings.lag_s + settings.filter_s - 0.5 * DT_S
    ahead = end.command - end.filtered
    assert ahead == pytest.approx(speed * late_s, abs=0.6 * DT_S * 0.02)


def test_how_often_one_looks_changes_nothing() -> None:
    """The same commands in periods of 4 ms and of 2 ms give the same way."""
    settings = DelayModelSettings(0.013, 0.011, 0.005, 0.0)
    rng = np.random.default_rng(1)
    commands = [rng.normal(size=3) for _ in range(20)]
    slow = run(commands, settings, 0.004)[-1]
    fast = run([c for c in commands for _ in (0, 1)][1:], settings, 0.002)[-1]
    assert fast.filtered == pytest.approx(slow.filtered, abs=1e-12)


def test_only_what_is_still_on_its_way_is_remembered() -> None:
    """An hour of commands takes no more memory than the delay is long."""
    settings = DelayModelSettings(0.02, 0.011, 0.005, 0.0)
    states = run([np.full(3, float(n)) for n in range(2000)], settings)
    assert len(states[-1].sent) <= 0.02 / DT_S + 3

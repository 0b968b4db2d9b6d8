"""The delay model from a command to the force: lag, delay and bounds."""

from copy import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from services.regulator.delay_model import DelayModelSettings, LoopDelayModel

DT_S = 0.004
vectors = hnp.arrays(float, 3, elements=st.floats(-0.01, 0.01))
delay_settings = st.builds(
    DelayModelSettings,
    delay_s=st.floats(0.0, 0.06),
    lag_s=st.floats(0.001, 0.03),
    filter_s=st.floats(0.0, 0.01),
)


def run(commands, settings, dt_s=DT_S):
    """Follow commands from rest at the first one; return a copy of every state."""
    model = LoopDelayModel(tuple(commands[0]))
    states = [copy(model)]
    for command in commands[1:]:
        model.follow(tuple(command), dt_s, settings)
        states.append(copy(model))
    return states


@given(delay_settings, vectors)
def test_a_constant_command_passes_unchanged(settings, command) -> None:
    """Without motion no command is in flight."""
    end = run([command] * 30, settings)[-1]
    assert end.filtered == pytest.approx(command, abs=1e-15)
    assert end.acceleration == pytest.approx(np.zeros(3), abs=1e-9)


@given(delay_settings, st.lists(vectors, min_size=2, max_size=40))
def test_the_output_stays_within_the_commands(settings, commands) -> None:
    """The model has no overshoot: no axis leaves the range of its commands."""
    low, high = np.min(commands, axis=0), np.max(commands, axis=0)
    for state in run(commands, settings):
        assert (np.array(state.filtered) >= low - 1e-15).all()
        assert (np.array(state.filtered) <= high + 1e-15).all()


@given(delay_settings, st.lists(vectors, min_size=2, max_size=40), vectors)
def test_the_output_does_not_depend_on_the_position(settings, commands, offset) -> None:
    """An offset of all commands gives the same offset of the output."""
    at_origin = run(commands, settings)[-1]
    shifted = run([command + offset for command in commands], settings)[-1]
    moved = np.subtract(shifted.filtered, at_origin.filtered)
    assert moved == pytest.approx(offset, abs=1e-12)
    assert shifted.acceleration == pytest.approx(at_origin.acceleration, abs=1e-6)


@given(delay_settings)
def test_a_uniform_motion_is_delayed_by_the_sum_of_all_delays(settings) -> None:
    """Delay, lag and filter add up, and half a period, because commands hold until the next one."""
    speed = np.array([0.0, 0.01, -0.02])
    end = run([speed * DT_S * step for step in range(150)], settings)[-1]
    late_s = settings.delay_s + settings.lag_s + settings.filter_s - 0.5 * DT_S
    ahead = np.subtract(end.command, end.filtered)
    assert ahead == pytest.approx(speed * late_s, abs=0.6 * DT_S * 0.02)


def test_the_output_does_not_depend_on_the_period() -> None:
    """The same commands in periods of 4 ms and of 2 ms give the same output."""
    settings = DelayModelSettings(0.013, 0.011, 0.005)
    rng = np.random.default_rng(1)
    commands = [rng.normal(size=3) for _ in range(20)]
    slow = run(commands, settings, 0.004)[-1]
    fast = run([c for c in commands for _ in (0, 1)][1:], settings, 0.002)[-1]
    assert fast.filtered == pytest.approx(slow.filtered, abs=1e-12)


def test_only_commands_in_flight_are_kept() -> None:
    """An hour of commands takes no more memory than the delay is long."""
    settings = DelayModelSettings(0.02, 0.011, 0.005)
    states = run([np.full(3, float(n)) for n in range(2000)], settings)
    assert len(states[-1].sent) <= 0.02 / DT_S + 3

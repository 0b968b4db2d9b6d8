"""The gain rule: what becomes of stiffness, delay and inertia in a cell file."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.regulator.settings import PROBE_N, law_settings, pi_gains
from services.regulator.tuning import LOOP_GAINS, instability, loop_delay_s, tune
from tests.fakes.bench import CELL

GAINS = pi_gains(tune(CELL).gains)


@given(st.floats(1e3, 1e6), st.floats(1.0, 1e4), st.floats(0.0, 0.2))
def test_the_gain_rule_is_045_over_k_tau_unless_inertia_is_in_the_way(k, k_tilt, delay_s) -> None:
    """K Ki tau = 0.45, or Ki = 0.5 / (m w_b) where that is less; force and torque alike."""
    update = {"stiffness_N_m": k, "tilt_stiffness_Nm_rad": k_tilt}
    contact = CELL.contact.model_copy(update=update)
    robot = CELL.robot.model_copy(update={"delay_s": delay_s})
    tuning = tune(CELL.model_copy(update={"contact": contact, "robot": robot}))
    bandwidth = CELL.robot.bandwidth_rad_s
    force_cap = 0.5 / (CELL.contact.inertia_kg * bandwidth)
    torque_cap = 0.5 / (CELL.contact.inertia_kg_m2 * bandwidth)
    for gain, stiffness, cap in (
        (tuning.force_i_m_per_Ns, k, force_cap),
        (tuning.torque_i_rad_per_Nms, k_tilt, torque_cap),
    ):
        if gain < cap:
            assert stiffness * gain * tuning.tau_s == pytest.approx(0.45)
        else:
            assert gain == cap
            assert stiffness * gain * tuning.tau_s <= 0.45 * (1.0 + 1e-12)


@given(
    st.sampled_from(sorted(LOOP_GAINS)),
    st.floats(1e3, 1e6),
    st.floats(1.0, 1e4),
    st.floats(0.0, 0.2),
    st.sampled_from(sorted(type(tune(CELL).gains).model_fields)),
)
def test_no_preset_is_unstable_and_what_would_be_is_named(preset, k, k_tilt, delay_s, name) -> None:
    """Any cell: the rule's own gains pass, one gain that is a thousand times too much does not."""
    update = {"stiffness_N_m": k, "tilt_stiffness_Nm_rad": k_tilt}
    contact = CELL.contact.model_copy(update=update)
    robot = CELL.robot.model_copy(update={"delay_s": delay_s})
    cell = CELL.model_copy(update={"contact": contact, "robot": robot})
    gains = tune(cell, preset).gains
    assert not instability(cell, gains)
    rule = (gains.force_i_m_per_Ns[0], gains.torque_i_rad_per_Nms[0])
    much = 1e3 * max(*rule, 1.0 / k, 1.0 / k_tilt)
    said = instability(cell, gains.model_copy(update={name: (0.0, 0.0, much)}))
    assert f": {name} above " in said


@pytest.mark.parametrize(
    ("section", "changes", "longer_s"),
    [
        ("robot", {"delay_s": 0.110}, 0.1),
        ("robot", {"lag_s": 0.1107}, 0.1),
        ("filter", {"lowpass_s": 0.105}, 0.1),
        ("filter", {"median": 5}, 0.002),  # a window of five is a sample later than one of three
        ("filter", {"median": 1}, -0.002),
        ("rates", {"sensor_hz": 100.0}, 0.008),  # the median's sample, five times as long
        ("rates", {"control_hz": 50.0}, 0.008),  # on average half a period is waited
    ],
)
def test_all_delay_of_the_loop_counts(
    section: str, changes: dict[str, float], longer_s: float
) -> None:
    """Delay, lag, filter, median and period: each by as much as it really delays."""
    changed = getattr(CELL, section).model_copy(update=changes)
    tau_s = loop_delay_s(CELL.model_copy(update={section: changed}))

    assert tau_s - loop_delay_s(CELL) == pytest.approx(longer_s)


def test_tau_is_the_sum_of_its_parts() -> None:
    """Nothing else is in it: the demo cell's numbers by hand."""
    parts_s = (0.010, 0.0107, 0.005, 0.002, 0.002, CELL.force.chain_s)

    assert loop_delay_s(CELL) == pytest.approx(sum(parts_s))


def test_proportional_gains_are_zero_unless_somebody_sets_them() -> None:
    """They only fight known lag; the same integral gain on all axes."""
    assert not GAINS.force_p_m_per_N.any()
    assert not GAINS.torque_p_rad_per_Nm.any()
    assert len(set(GAINS.force_i_m_per_Ns)) == len(set(GAINS.torque_i_rad_per_Nms)) == 1


def test_the_approach_is_as_slow_as_its_force_budget_asks_for() -> None:
    """The first touch adds about k v tau: never more than budget or probe, nor over the wish."""
    tau_s = tune(CELL).tau_s
    for stiffness in (1e3, 2e4, 1e6):
        contact = CELL.contact.model_copy(update={"stiffness_N_m": stiffness})
        settings = law_settings(CELL.model_copy(update={"contact": contact}))
        budget = min(CELL.force.approach_budget_N, PROBE_N)
        affordable_m_s = budget / (stiffness * tau_s)
        assert settings.approach_m_s == pytest.approx(min(affordable_m_s, CELL.force.approach_m_s))

"""Gain rule: gains from the stiffness, delay and inertia of a cell file."""

from math import inf, nextafter, pi

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from common.config.cell import CellConfig
from common.config.plant import PROBE_N
from control.gain_rule import instability, tune
from control.law import LawSettings
from forcemesh.messages import Gains, Preset
from tests.fakes.bench import CELL


def cell_of(k: float, k_tilt: float, delay_s: float) -> CellConfig:
    """Return the demo's cell with another contact and another delay."""
    update = {"stiffness_N_m": k, "tilt_stiffness_Nm_rad": k_tilt}
    contact = CELL.contact.model_copy(update=update)
    robot = CELL.robot.model_copy(update={"delay_s": delay_s})
    return CELL.model_copy(update={"contact": contact, "robot": robot})


@pytest.mark.parametrize(
    ("preset", "loop_gain", "inertia"),
    [("gentle", 0.2, 0.5 * 0.2 / 0.45), ("normal", 0.45, 0.5), ("stiff", 0.6, 0.5)],
)
@given(k=st.floats(1e3, 1e6), k_tilt=st.floats(1.0, 1e4), delay_s=st.floats(0.0, 0.2))
@example(k=1e3, k_tilt=1.0, delay_s=0.0)  # limited by inertia
def test_the_gain_rule_is_045_over_k_tau_unless_inertia_limits_the_gain(
    preset: Preset, loop_gain: float, inertia: float, k: float, k_tilt: float, delay_s: float
) -> None:
    """K Ki tau = 0.2, 0.45 or 0.6, or Ki = 0.5 / (m w_b) where that is less; torque alike."""
    tuning = tune(cell_of(k, k_tilt, delay_s), preset)
    contact, bandwidth = CELL.contact, CELL.robot.bandwidth_rad_s
    force = min(loop_gain / (k * tuning.tau_s), inertia / (contact.inertia_kg * bandwidth))
    torque = min(loop_gain / (k_tilt * tuning.tau_s), inertia / (contact.inertia_kg_m2 * bandwidth))
    assert tuning.force_i_m_per_Ns == pytest.approx(force)
    assert tuning.torque_i_rad_per_Nms == pytest.approx(torque)
    assert not any((*tuning.gains.force_p_m_per_N, *tuning.gains.torque_p_rad_per_Nm))
    assert not instability(cell_of(k, k_tilt, delay_s), tuning.gains)


@pytest.mark.parametrize(
    ("k", "k_tilt", "delay_s"), [(2e4, 100.0, 0.01), (1e3, 1.0, 0.0), (1e6, 1e4, 0.2)]
)
def test_gains_are_reported_unstable_only_above_the_theoretical_limit(k, k_tilt, delay_s) -> None:
    """K Kp = 1, k Ki tau = pi / 2 and Ki = 1 / (m w_b), the last number allowed; torque alike."""
    cell = cell_of(k, k_tilt, delay_s)
    tau_s, bandwidth = tune(cell).tau_s, cell.robot.bandwidth_rad_s
    kg, kg_m2 = cell.contact.inertia_kg, cell.contact.inertia_kg_m2
    ends = {
        "force_p_m_per_N": 1.0 / k,
        "force_i_m_per_Ns": min(pi / 2 / (k * tau_s), 1.0 / (kg * bandwidth)),
        "torque_p_rad_per_Nm": 1.0 / k_tilt,
        "torque_i_rad_per_Nms": min(pi / 2 / (k_tilt * tau_s), 1.0 / (kg_m2 * bandwidth)),
    }
    where = f"unstable at contact.stiffness_N_m {k:g} and a delay of {1e3 * tau_s:.0f} ms: "
    for name, end in ends.items():
        assert not instability(cell, Gains.from_dict({name: (0.0, end, 0.5 * end)}))
        beyond = Gains.from_dict({name: (0.0, nextafter(end, inf), 0.5 * end)})
        assert instability(cell, beyond) == f"{where}{name} above {end:.2g}"
    every = Gains.from_dict({name: (2.0 * end,) * 3 for name, end in ends.items()})
    named = ", ".join(f"{name} above {end:.2g}" for name, end in ends.items())
    assert instability(cell, every) == where + named


@pytest.mark.parametrize(
    ("section", "changes", "longer_s"),
    [
        ("robot", {"delay_s": 0.110}, 0.1),
        ("robot", {"lag_s": 0.1107}, 0.1),
        ("filter", {"lowpass_s": 0.105}, 0.1),
        ("filter", {"median": 5}, 0.002),  # a window of five is a sample later than one of three
        ("filter", {"median": 1}, -0.002),
        ("rates", {"sensor_hz": 100.0}, 0.008),  # the median's sample, five times as long
        ("rates", {"control_hz": 50.0}, 0.008),  # the mean wait is half a period
    ],
)
def test_all_delay_of_the_loop_counts(section, changes, longer_s) -> None:
    """Delay, lag, filter, median and period: each by as much as it really delays."""
    changed = getattr(CELL, section).model_copy(update=changes)
    tau_s = CELL.model_copy(update={section: changed}).plant.tau_s

    assert tau_s - CELL.plant.tau_s == pytest.approx(longer_s)


def test_the_approach_speed_keeps_the_first_touch_within_its_force_budget() -> None:
    """The first touch adds about k v tau: at most budget or probe; the set speed is a limit too."""
    tau_s = tune(CELL).tau_s
    for stiffness in (1e3, 2e4, 1e6):
        contact = CELL.contact.model_copy(update={"stiffness_N_m": stiffness})
        settings = LawSettings.of(CELL.model_copy(update={"contact": contact}))
        budget = min(CELL.force.approach_budget_N, PROBE_N)
        affordable_m_s = budget / (stiffness * tau_s)
        assert settings.approach_m_s == pytest.approx(min(affordable_m_s, CELL.force.approach_m_s))

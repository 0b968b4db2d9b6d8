"""Advice of `tune`: gains are safe by their stated margins, and a cell file can use the result."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cli.tune import output as words
from common.config.load import load_cell
from control.gain_rule import tune
from forcemesh.messages import Host
from tests.fakes.bench import CELL, DEMO
from tuning import advice
from tuning.advice import MeasuredCell, advise
from tuning.contact_response import ContactResponse
from tuning.contact_spring import Spring
from tuning.margins import Loop, margins, release_response
from tuning.servo import Servo

SERVO = Servo(0.03, 5e-4, 0.005, 0.012)
SPRING = Spring(2e4, 100.0)
measured = st.builds(
    lambda delay, lag, share, deviation, k: MeasuredCell(
        Servo(delay + lag, deviation, share * lag, lag), Spring(k, 0.01 * k)
    ),
    st.floats(0.0, 0.1),
    st.floats(0.002, 0.05),
    st.floats(0.2, 1.0),
    st.floats(5e-4, 3e-3),
    st.floats(3.0, 5.3).map(lambda x: 10.0**x),
)


def advised(found: MeasuredCell, **now: float) -> advice.Advice:
    """Return the advice for the demo's cell."""
    gains = {"force_now": 1e-3, "torque_now": 0.1} | now
    return advise(CELL, found, "pc", **gains)


@settings(max_examples=6)
@given(found=measured)
def test_recommended_gains_are_stable_with_the_stated_margins(found) -> None:
    """At least 50 degrees and a factor of two; 0.9 of the delay margin more is still stable."""
    for one in (advised(found).force, advised(found).torque):
        assert one.margins.stable
        assert one.margins.phase_deg >= advice.LEAST_PHASE_DEG
        assert one.margins.gain_margin >= advice.LEAST_GAIN
        assert one.forecast.overshoot_pct < 6.0
        of, loop = one.margins, one.loop
        assert margins(replace(loop, delay_s=loop.delay_s + 0.9 * of.delay_s)).stable
        stiffer = 0.9 * of.gain_margin * loop.stiffness
        heavier = 0.9 * of.gain_margin * loop.inertia
        assert margins(replace(loop, stiffness=stiffer, inertia=heavier)).stable


# Rounding up to whole milliseconds costs a fast arm on a soft contact 15.01 % of its gain.
@example(found=MeasuredCell(Servo(0.0039, 0.0005, 0.00195, 0.0039), Spring(3162.3, 31.6)))
@settings(max_examples=6)
@given(found=measured)
def test_the_lines_give_a_cell_the_gains_that_are_recommended(found, tmp_path_factory) -> None:
    """A cell that loads the written file has the same gains or slightly lower ones, and can arm."""
    one = advised(found)
    folder = tmp_path_factory.mktemp("cell")
    words.save_sections(folder / "tuning.yaml", advice.cell_file_sections(CELL, found, [one]))
    text = DEMO.read_text().replace("force: {}", "force: {}\ntuning: tuning.yaml")
    (folder / "cell.yaml").write_text(text)
    cell = load_cell(folder / "cell.yaml")
    gain = tune(cell).force_i_m_per_Ns
    assert gain <= 1.01 * one.force.gain
    assert gain >= 0.84 * one.force.gain
    assert cell.force.approach_m_s <= cell.plant.approach_limit_m_s
    arm_s = cell.robot.delay_s + cell.robot.lag_s
    assert found.servo.bound_s - 1e-9 <= arm_s <= found.servo.bound_s + 0.0015
    least_s, most_s = found.servo.lags_s
    assert least_s <= cell.robot.lag_s <= most_s + 1e-4
    assert load_cell(folder / "cell.yaml", {"robot.delay_s": 0.2}).robot.delay_s == 0.2


def test_an_unstable_gain_and_a_stiffness_that_was_not_measured_are_reported() -> None:
    """Ten times the rule's gain is not stable; JSON has no infinite margins."""
    found = MeasuredCell(SERVO, None)
    one = advised(found, force_now=10.0 * advised(found).force.gain, torque_now=0.0)
    text = "\n".join(words.report_lines(CELL, found, [one], {}))
    assert "NOT STABLE" in text
    assert "stiffness not measured (cell file: 20000)" in text
    plain = advice.as_dict(CELL, found, [one], {})
    assert plain["hosts"]["pc"]["orientation_now"]["delay_s"] is None


def test_the_slower_host_sets_the_delay_of_the_cell_file() -> None:
    """Both hosts share one delay: the controller's bound, when its loop is the slower one."""
    found = MeasuredCell(SERVO, SPRING, ContactResponse(0.12, 0.002))
    both = [
        advise(CELL, found, host, force_now=1e-3, torque_now=0.1) for host in ("pc", "controller")
    ]
    assert both[1].tau_s == pytest.approx(0.124)
    assert both[1].force.gain < both[0].force.gain
    robot = advice.cell_file_sections(CELL, found, both)["robot"]
    longer_s = 0.124 - both[0].tau_s
    assert robot["delay_s"] + robot["lag_s"] == pytest.approx(SERVO.bound_s + longer_s, abs=1.5e-3)
    lines = words.report_lines(CELL, found, both, advice.cell_file_sections(CELL, found, both))
    assert any("own loop 120 +/- 4 ms" in line for line in lines)


@pytest.mark.parametrize(
    ("found", "loop_hz", "reason"),
    [
        (MeasuredCell(replace(SERVO, sum_s=0.16), SPRING), 250.0, "too slow: the loop delay is "),
        (
            MeasuredCell(SERVO, SPRING, ContactResponse(0.16, 0.01)),
            250.0,
            "delay is 180 ms, the law",
        ),
        (MeasuredCell(SERVO, Spring(4e3, 10.0)), 60.0, "contact.stiffness_N_m at 5000 or above"),
        (MeasuredCell(SERVO, Spring(2e5, 1e3)), 15.0, ""),
    ],
)
def test_nothing_is_recommended_outside_the_measured_range_of_the_law(found, loop_hz, reason):
    """Too slow, too stiff or too soft: the reason is reported, without gains or file lines."""
    rates = CELL.rates.model_copy(update={"control_hz": loop_hz, "robot_hz": loop_hz})
    cell = CELL.model_copy(update={"rates": rates})
    hosts: tuple[Host, ...] = ("pc",) if found.controller is None else ("pc", "controller")
    both = [advise(cell, found, host, force_now=1e-3, torque_now=0.1) for host in hosts]
    sections = advice.cell_file_sections(cell, found, both)
    assert reason in advice.refusal_reason(cell, found, both)
    lines = words.report_lines(cell, found, both, sections)
    assert any("recommended  " in line for line in lines) != bool(reason)
    assert ("for the cell file:" in lines) != bool(reason)
    plain = advice.as_dict(cell, found, both, sections)
    assert (plain["cell_file"] is None) == bool(plain["refused"]) == bool(reason)
    assert all(("gains" in host) != bool(reason) for host in plain["hosts"].values())


def test_gains_allow_for_the_worst_split_and_two_standard_deviations_of_delay() -> None:
    """The gain is below those of both ends of the range; more uncertainty means less gain."""
    found = MeasuredCell(SERVO, SPRING)
    one = advised(found)
    for lag_s in SERVO.lags_s:
        exact = replace(SERVO, deviation_s=0.0, lag_least_s=lag_s, lag_most_s=lag_s)
        assert one.force.gain < advised(replace(found, servo=exact)).force.gain
    unsure = replace(SERVO, deviation_s=5e-3)
    assert advised(replace(found, servo=unsure)).force.gain < one.force.gain


# --- margins ------------------------------------------------------------------------------------

loops = st.builds(
    lambda k, delay, lag, low, c, m: Loop(k, 0.0, delay, lag, low, m).with_gain(
        c / (k * (delay + lag + low))
    ),
    st.floats(3.0, 5.3).map(lambda x: 10.0**x),
    st.floats(0.004, 0.1),
    st.floats(0.004, 0.05),
    st.floats(0.001, 0.02),
    st.floats(0.1, 1.2),
    st.floats(0.0, 2.0),
)


def is_oscillating(loop: Loop) -> bool:
    """Return whether a release grows instead of decaying, by the model in the time domain."""
    t, force = release_response(loop, 150.0)
    tail = np.abs(force[t > 0.8 * t[-1]]).max()
    middle = np.abs(force[(t > 0.2 * t[-1]) & (t < 0.4 * t[-1])]).max()
    return bool(tail > max(middle, 1e-6) or np.abs(force).max() > 10.0)


@settings(max_examples=12)
@given(loops)
def test_the_delay_margin_is_the_added_delay_that_keeps_a_loop_stable(loop: Loop) -> None:
    """By a model in the time domain: 0.8 of the margin decays, 1.25 of it oscillates."""
    found = margins(loop)
    if not found.stable:
        assert is_oscillating(loop)
        return
    less = replace(loop, delay_s=loop.delay_s + 0.8 * found.delay_s)
    more = replace(loop, delay_s=loop.delay_s + 1.25 * found.delay_s)
    assert margins(less).stable
    assert not margins(more).stable
    assert not is_oscillating(less)
    assert is_oscillating(more)

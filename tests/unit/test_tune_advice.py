"""What tune advises is safe by its own margins, and a cell takes the file that it writes."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.tuning import advice, words
from cli.tuning.advice import Measured, advise
from cli.tuning.identify import Servo, Spring
from cli.tuning.margins import Loop, margins
from common.config import load_cell
from common.errors import ConfigError, DataError
from services.regulator.tuning import tune
from tests.fakes.bench import CELL

CELL_FILE = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
measured = st.builds(
    lambda delay, lag, k: Measured(Servo(delay, lag, 1e-6, 1e-5), Spring(k, 0.01 * k)),
    st.floats(0.0, 0.1),
    st.floats(0.002, 0.05),
    st.floats(3.0, 5.3).map(lambda x: 10.0**x),
)


def advised(found: Measured, **now: float) -> advice.Advice:
    """Return the advice for the demo's cell."""
    gains = {"force_now": 1e-3, "torque_now": 0.1} | now
    return advise(CELL, found, "pc", **gains)


@settings(max_examples=6)
@given(found=measured)
def test_what_is_recommended_is_stable_with_the_margins_that_are_stated(found: Measured) -> None:
    """At least 50 degrees and a factor of two, and at 0.9 of the delay margin more it still is."""
    for one in (advised(found).force, advised(found).torque):
        assert one.margins.stable
        assert one.margins.phase_deg >= advice.LEAST_PHASE_DEG
        assert one.margins.gain >= advice.LEAST_GAIN
        assert one.forecast.overshoot_pct < 6.0
        loop = one.loop
        later = Loop(
            loop.stiffness,
            loop.gain,
            loop.delay_s + 0.9 * one.margins.delay_s,
            loop.lag_s,
            loop.filter_s,
            loop.inertia,
        )
        assert margins(later).stable
        stiffer = Loop(
            0.9 * one.margins.gain * loop.stiffness,
            loop.gain,
            loop.delay_s,
            loop.lag_s,
            loop.filter_s,
            0.9 * one.margins.gain * loop.inertia,
        )
        assert margins(stiffer).stable


@settings(max_examples=6)
@given(found=measured)
def test_the_lines_give_a_cell_the_gains_that_are_recommended(
    found: Measured, tmp_path_factory
) -> None:
    """Written, named by a cell file, loaded: the same gains or a little less, and it can arm."""
    one = advised(found)
    folder = tmp_path_factory.mktemp("cell")
    words.save(folder / "tuning.yaml", advice.lines(CELL, found, [one]))
    text = CELL_FILE.read_text().replace("force: {}", "force: {}\ntuning: tuning.yaml")
    (folder / "cell.yaml").write_text(text)
    cell = load_cell(folder / "cell.yaml")
    gain = tune(cell).force_i_m_per_Ns
    assert gain <= 1.01 * one.force.gain
    assert gain >= 0.85 * one.force.gain
    assert cell.force.approach_m_s <= cell.approach_limit_m_s
    assert found.servo.delay_s <= cell.robot.delay_s <= found.servo.delay_s + 0.0025
    assert load_cell(folder / "cell.yaml", {"robot.delay_s": 0.2}).robot.delay_s == 0.2


def test_a_gain_that_does_not_bear_what_was_found_is_called_so() -> None:
    """Ten times the rule's: not stable; none at all: does nothing; no press: it is said."""
    found = Measured(Servo(0.02, 0.01, 1e-6, 1e-5), Spring(2e4, 100.0))
    one = advised(found, force_now=10.0 * advised(found).force.gain, torque_now=0.0)
    lines = words.told(CELL, found, [one], advice.lines(CELL, found, [one]))
    assert any("now" in line and "NOT STABLE" in line for line in lines)
    assert any("does nothing" in line for line in lines)
    assert any("20000 +- 100 N/m" in line for line in lines)
    blind = Measured(found.servo, None)
    lines = words.told(CELL, blind, [advised(blind)], advice.lines(CELL, blind, [advised(blind)]))
    assert any("stiffness not measured (cell file: 20000)" in line for line in lines)
    plain = advice.as_dict(blind, [advised(blind, force_now=0.0)], {})
    assert plain["hosts"]["pc"]["position_now"]["delay_s"] is None
    assert plain["tau_s"] == pytest.approx(advised(blind).tau_s)


def test_the_slower_host_decides_what_the_cell_file_says() -> None:
    """One delay serves both: the controller's, when its loop is the slower one."""
    found = Measured(Servo(0.02, 0.01, 1e-6, 1e-5), Spring(2e4, 100.0), controller_tau_s=0.12)
    both = [
        advise(CELL, found, host, force_now=1e-3, torque_now=0.1) for host in ("pc", "controller")
    ]
    assert both[1].tau_s == pytest.approx(0.12)
    assert both[1].force.gain < both[0].force.gain
    robot = advice.lines(CELL, found, both)["robot"]
    assert robot["delay_s"] == pytest.approx(0.02 + 0.12 - both[0].tau_s, abs=0.0025)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("- 1\n", "it must hold sections"),
        ("robot: 3\n", "it must hold sections"),
        ("robot: {delays_s: 0.1}\n", "robot.delays_s"),
        ("limits: {force_N: 900}\n", "limits.force_N"),
    ],
)
def test_a_tuning_file_may_say_what_is_measured_and_nothing_else(
    tmp_path: Path, text, says
) -> None:
    """No limit goes up through the back door; a file that is not there is said, too."""
    (tmp_path / "tuning.yaml").write_text(text)
    cell = tmp_path / "cell.yaml"
    cell.write_text(CELL_FILE.read_text() + "\ntuning: tuning.yaml\n")
    with pytest.raises(ConfigError, match=says):
        load_cell(cell)
    (tmp_path / "tuning.yaml").unlink()
    with pytest.raises(ConfigError, match="no such file"):
        load_cell(cell)


def test_a_file_that_was_there_is_kept_beside_the_new_one(tmp_path: Path) -> None:
    """As `calibrate` does; where nothing can be written it is said."""
    path = tmp_path / "sub" / "tuning.yaml"
    words.save(path, {"robot": {"delay_s": 0.01}})
    words.save(path, {"robot": {"delay_s": 0.02}})
    assert yaml.safe_load(path.read_text()) == {"robot": {"delay_s": 0.02}}
    kept = path.with_name("tuning.before.yaml").read_text()
    assert yaml.safe_load(kept) == {"robot": {"delay_s": 0.01}}
    assert path.read_text().startswith("# What `forcemesh tune` has measured")
    with pytest.raises(DataError, match="cannot be written"):
        words.save(tmp_path, {})

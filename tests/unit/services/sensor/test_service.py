"""The sensor service: which samples it publishes, with which faults, and of which sensor."""

from itertools import pairwise
from math import inf, nan

import pytest

from common.config.load import load_cell
from common.runtime.service import refuse_other_implementation
from forcemesh.errors import ConfigError
from forcemesh.messages import ZERO3
from services.sensor.driver import SensorSample
from tests.fakes.bench import DEMO
from tests.fakes.netft_rig import FITTING, PERIOD_S, RATE_HZ, REAL_CELL, NetftRig
from tools.tree import ROOT

FROM_PAGE = {"sensor.calibration": "page"}

# --- decimation -----------------------------------------------------------------------------------


def test_the_service_decimates_and_reports_a_bad_sample_between_two_good_ones() -> None:
    """Every fifth of 1000 Hz for a cell of 200 Hz, also after a silence; the worst one counts."""
    rig = NetftRig(cell={"rates.sensor_hz": 200.0})
    rig.run(0.6)
    messages = rig.run(1.0)
    assert {after.counter - before.counter for before, after in pairwise(messages)} == {5}
    assert (rig.counters["keep_every"], rig.counters["sensor_hz"]) == (5, RATE_HZ)
    while not rig.run(PERIOD_S):
        pass
    rig.switch(saturate="on")
    assert rig.run(PERIOD_S) == []
    rig.switch(saturate="off")
    assert [message.status for message in rig.run(9 * PERIOD_S)] == ["saturated", "ok"]
    rig.switch(mute="on")
    rig.run(0.3)
    rig.switch(mute="off")
    good = [message for message in rig.run(0.3) if message.valid]
    assert len(good) == pytest.approx(0.3 * 200.0, abs=7)


# --- any driver -----------------------------------------------------------------------------------


def test_each_sample_has_the_serial_number_of_the_sensor_that_measured_it() -> None:
    """Also when it is read after the first sample, and of another sensor on the same cable."""
    rig = NetftRig(FITTING._replace(serial="FT1"), page_fault="slow", cell=FROM_PAGE)
    assert {message.serial for message in rig.run(0.1)} == {""}
    assert rig.page is not None
    rig.page.fault = ""
    assert rig.run(0.1)[-1].serial == "FT1"
    rig.page.about = rig.page.about._replace(serial="FT2")
    assert rig.run(0.1)[-1].serial == "FT1"
    rig.switch(restart=True)
    assert rig.run(0.5)[-1].serial == "FT2"


@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_reading_that_is_not_finite_is_a_fault(
    number: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Published as one, with its axis; the next good reading is published as usual."""
    rig = NetftRig()
    rig.run(0.1)
    sample = SensorSample((0.0, number, 0.0), ZERO3, counter=101)
    with monkeypatch.context() as broken:
        broken.setattr(rig.driver, "read", lambda _now_ns: [sample])
        (message,) = rig.run(PERIOD_S)
    assert (message.valid, message.status, message.code) == (False, "fault", "sensor_fault")
    assert message.reason == f"Fy reads {number}: not finite"
    assert (message.force_N, message.counter) == (ZERO3, 101)
    assert rig.run(2 * PERIOD_S)[-1].valid


# --- its cell -------------------------------------------------------------------------------------


def test_the_template_of_a_real_cell_has_lower_limits_than_the_demo() -> None:
    """It loads, drives a real arm and sensor, and has every host of the loop."""
    real, demo = load_cell(REAL_CELL), load_cell(DEMO)
    assert (real.roles.robot, real.roles.sensor) == ("gateway", "driver")
    assert set(real.robot.hosts) == {"pc", "controller"}
    assert real.deadlines == type(real.deadlines)()
    for name in ("step_m", "step_deg", "speed_m_s", "speed_deg_s", "tether_m", "force_N"):
        assert getattr(real.limits, name) < getattr(demo.limits, name)


@pytest.mark.parametrize(
    ("role", "own", "cell", "other_cell"),
    [
        ("robot", "sim", "demo", "rs007l-real"),
        ("robot", "gateway", "rs007l-real", "demo"),
        ("sensor", "driver", "rs007l-real", "demo"),
    ],
)
def test_a_process_refuses_a_role_that_the_cell_gives_to_another(
    role: str, own: str, cell: str, other_cell: str
) -> None:
    """Two processes never have one role; the error names the field and both remedies."""
    refuse_other_implementation(load_cell(ROOT / "cells" / f"{cell}.yaml"), role, own)
    other = load_cell(ROOT / "cells" / f"{other_cell}.yaml")
    with pytest.raises(ConfigError, match=rf"roles\.{role} is \w+.*the {own}.*{role}: "):
        refuse_other_implementation(other, role, own)

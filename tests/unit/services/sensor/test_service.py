"""The sensor service: which samples it publishes, with which faults, and of which sensor."""

import random
from collections.abc import Sequence
from itertools import pairwise
from math import inf, nan

import pytest

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.runtime.service import refuse_other_implementation
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError
from forcemesh.messages import ZERO3, Vec3
from services.sensor.driver import NO_FAULT, Info, SensorFault, SensorSample
from services.sensor.service import Decimation, SensorDriver
from tests.fakes.bench import DEMO, Bench
from tests.fakes.netft_rig import PERIOD_S, RATE_HZ, REAL_CELL, NetftRig
from tools.tree import ROOT

# --- decimation -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.1, 1.0, 2.0, 2.5, 4.0, 7.0, 14.0])
@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_a_faster_sensor_is_decimated_by_the_nearest_divisor(ratio: float, loss: float) -> None:
    """Up to twice the rate all is kept; the next sample replaces a lost one; a gap changes none."""
    rng = random.Random(1)
    rate_hz, kept, state = 500.0 * ratio, 0, Decimation(500.0)
    count = round(3 * rate_hz)
    for number in range(count):
        if rng.random() >= loss:
            is_kept = state.keeps(number, round(number * NS_PER_S / rate_hz))
            kept += is_kept and number >= rate_hz
    divisor = 1 if ratio <= 2.0 else round(ratio)
    assert state.keep_every == divisor
    lost_share = loss if divisor == 1 else 0.6 * loss
    assert (1.0 - 1.3 * lost_share) * 2 * rate_hz <= kept * divisor <= 2 * rate_hz + 2 * divisor
    state.pause()
    for number in range(count, count + 10):
        state.keeps(number, 10 * NS_PER_S + round(number * NS_PER_S / rate_hz))
        assert state.keep_every == divisor


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


class ScriptedDriver:
    """A driver of the sensor that is plugged in, if any; the test sets its reading."""

    where = "a sensor"

    def __init__(self) -> None:
        self.serial: str | None = "FT1"
        self.has_info = True
        self.force_N: Vec3 = (1.0, 2.0, 3.0)
        self._counter = 0

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return one sample while a sensor is plugged in."""
        if self.serial is None:
            return []
        self._counter += 1
        return [SensorSample(self.force_N, ZERO3, counter=self._counter, stamp_ns=now_ns)]

    def silence_fault(self) -> SensorFault:
        """Return no fault."""
        return NO_FAULT

    def info(self) -> Info | None:
        """Return the sensor's own description."""
        known = self.has_info and self.serial is not None
        return Info("fake", 100.0, 10.0, "its own", self.serial or "") if known else None

    def counters(self) -> dict[str, int]:
        """Count nothing."""
        return {}

    def close(self) -> None:
        """Release nothing."""


def bench_of(driver: ScriptedDriver) -> Bench:
    """Return a bench of the service with this driver."""

    def make(bus: Bus, cell: CellConfig) -> SensorDriver:
        return SensorDriver(bus, cell, driver)

    return Bench("sensor", make, step_s=0.002)


def test_each_sample_has_the_serial_number_of_the_sensor_that_measured_it() -> None:
    """Also when it is read after the first sample, and of another sensor on the same cable."""
    driver = ScriptedDriver()
    driver.has_info = False
    bench = bench_of(driver)
    assert bench.after_step(topics.SENSOR_WRENCH).serial == ""
    driver.has_info = True
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT1"
    driver.serial = None
    bench.pass_s(1.0)
    driver.serial = "FT2"
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT2"


@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_reading_that_is_not_finite_is_a_fault(number: float) -> None:
    """Published as one, with its axis; the next good reading is published as usual."""
    driver = ScriptedDriver()
    bench = bench_of(driver)
    driver.force_N = (0.0, number, 0.0)
    message = bench.after_step(topics.SENSOR_WRENCH)
    assert (message.valid, message.status, message.code) == (False, "fault", "sensor_fault")
    assert message.reason == f"Fy reads {number}: not finite"
    assert message.force_N == ZERO3
    driver.force_N = (1.0, 2.0, 3.0)
    assert bench.after_step(topics.SENSOR_WRENCH).force_N == (1.0, 2.0, 3.0)


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

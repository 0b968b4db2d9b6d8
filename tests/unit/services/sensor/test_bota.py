"""The Bota adapter, on a fake source and on the manufacturer's dummy sensor."""

import json
import sys
import time
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell_sensor import SensorSection
from common.config.load import load_cell
from forcemesh.errors import ConfigError
from services.sensor.bota import WRAP_US, BotaDriver, bota_driver
from services.sensor.driver import SensorSample
from tests.fakes.netft_rig import REAL_CELL

STEP_US = 1000
DUMMY = {
    "driver_config": {
        "product_name": "BFT-DUMMY-DUMMY-DUMMY",
        "serial_number": "BFT00001",
        "communication_interface_name": "Bota_Dummy",
        "communication_interface_params": {},
        "sensor_operation_params": {"app_mode": 0, "app_submode": 0, "sinc_length": 512},
        "driver_operation_params": {"register_with_daemon": False},
    }
}


@cache
def section(device: str = "a file") -> SensorSection:
    """Return the section of a cell file for this sensor."""
    return load_cell(REAL_CELL, {"sensor.driver": "bota", "sensor.device": device}).sensor


class BotaBench:
    """A driver on a clock, and its source: the test sets each reading, or the fault."""

    def __init__(self) -> None:
        self.fault, self.now_ns = "", 0
        source: Any = SimpleNamespace(
            read_frame=self._frame, get_expected_timestep_us=lambda: STEP_US
        )
        self.driver = BotaDriver(section(), source)

    def read(self, stamp_us: int, *, force_N: float = 1.0, **status: int) -> list[SensorSample]:
        """Supply one reading and return the samples of the driver."""
        self.now_ns += STEP_US * 1000
        flags = {"invalid": 0, "overrange": 0, "val": 0} | status
        self._reading = SimpleNamespace(
            timestamp=stamp_us % WRAP_US,
            force=[force_N, 2.0, 3.0],
            torque=[0.1, 0.2, 0.3],
            status=SimpleNamespace(**flags),
        )
        return list(self.driver.read(self.now_ns))

    def _frame(self) -> SimpleNamespace:
        if self.fault:
            raise RuntimeError(self.fault)
        return self._reading


@given(st.integers(0, WRAP_US - 1), st.lists(st.integers(1, 50), min_size=1, max_size=40))
def test_every_reading_is_a_sample_or_counted_as_lost(start_us: int, steps: list[int]) -> None:
    """The last counter is the number of elapsed periods, also where the stamps wrap."""
    bench, stamp_us = BotaBench(), start_us
    samples = bench.read(stamp_us)
    for step in steps:
        stamp_us += step * STEP_US
        samples += bench.read(stamp_us)
        assert bench.read(stamp_us) == []
    counters = bench.driver.counters()
    assert samples[-1].counter == 1 + sum(steps)
    assert (counters["records"], counters["lost"]) == (len(steps) + 1, sum(steps) - len(steps))
    assert counters["sensor_restarts"] == 0


@pytest.mark.parametrize(
    ("reading", "status", "code"),
    [
        ({}, "ok", ""),
        ({"invalid": 1}, "fault", "sensor_fault"),
        ({"overrange": 1}, "saturated", "sensor_saturated"),
        ({"force_N": 190.0}, "saturated", "sensor_saturated"),
    ],
)
def test_status_bits_and_range_set_the_status_of_a_sample(
    reading: dict, status: str, code: str
) -> None:
    """The status follows the sensor's own bits and 95 % of the range of the cell file."""
    (sample,) = BotaBench().read(STEP_US, **reading)
    assert (sample.status, sample.code) == (status, code)


def test_restarts_and_many_losses_are_faults() -> None:
    """A restart for 249 samples; a lossy line when every second reading is lost."""
    bench = BotaBench()
    bench.read(10_000_000)
    codes = [bench.read(100 + place * STEP_US)[0].code for place in range(300)]
    assert codes[:249] == ["sensor_restarted"] * 249
    assert codes[-1] == ""
    bench = BotaBench()
    codes = [bench.read(2 * place * STEP_US)[0].code for place in range(1, 80)]
    assert (codes[0], codes[-1]) == ("", "sensor_lossy")


def test_silence_stall_and_a_broken_line_have_different_reports() -> None:
    """A constant stamp is a stalled sensor; an error of the package is passed on."""
    bench = BotaBench()
    assert bench.driver.silence_fault().code == "sensor_silent"
    bench.read(STEP_US)
    bench.read(STEP_US)
    assert bench.driver.silence_fault().code == "sensor_stalled"
    bench.fault = "no carrier"
    assert bench.read(STEP_US) == []
    assert bench.driver.silence_fault() == ("sensor_silent", "Bota sensor of a file: no carrier")


def test_a_missing_package_or_configuration_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the field of the cell file, or the command that installs the package."""
    with pytest.raises(ConfigError, match=r"sensor\.device: .*no-such-file"):
        bota_driver(section("no-such-file.json"), stale_after_s=0.02)
    monkeypatch.setitem(sys.modules, "bota_driver", None)
    with pytest.raises(ConfigError, match="pip install bota-driver"):
        bota_driver(section(), stale_after_s=0.02)


@pytest.mark.realtime
def test_the_makers_dummy_sensor_is_read(tmp_path: Path) -> None:
    """The real package delivers each reading once, with increasing stamps."""
    path = tmp_path / "dummy.json"
    path.write_text(json.dumps(DUMMY), encoding="utf-8")
    driver = bota_driver(section(str(path)), stale_after_s=1.0)
    samples: list[SensorSample] = []
    deadline_s = time.monotonic() + 20.0
    while len(samples) < 4 and time.monotonic() < deadline_s:
        samples += driver.read(time.monotonic_ns())
    driver.close()
    assert {sample.status for sample in samples} == {"ok"}
    counters = [sample.counter for sample in samples]
    assert counters == sorted(set(counters))
    assert "10 Hz" in driver.info().calibration

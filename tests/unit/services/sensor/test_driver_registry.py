"""Drivers by name: ours, and one of another package, found by its entry point."""

from pathlib import Path

import pytest

from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.errors import ConfigError
from services.sensor.driver_registry import OURS, driver_of, installed_drivers, unknown_driver
from services.sensor.service import SensorDriver
from tests.fakes.bench import Bench
from tests.fakes.netft_rig import REAL_CELL

TINY = """
from services.sensor.driver import Info, SensorFault, SensorSample


class TinyDriver:
    where = "a tiny sensor"

    def __init__(self, sensor):
        self._range_N, self._counter = sensor.force_range_N, 0

    def read(self, now_ns):
        self._counter += 1
        force_N, torque_Nm = (1.0, 2.0, self._range_N), (0.0, 0.0, 0.0)
        return [SensorSample(force_N, torque_Nm, counter=self._counter, stamp_ns=now_ns)]

    def silence_fault(self):
        return SensorFault("sensor_silent", "unplugged")

    def info(self):
        return Info("tiny", 100.0, 10.0, "its own", "T1")

    def counters(self):
        return {"records": self._counter}

    def close(self):
        pass


def make(sensor, *, stale_after_s):
    return TinyDriver(sensor)
"""
ENTRY_POINTS = """[forcemesh.sensor_drivers]
tiny = tiny_sensor:make
absent = no_such_module:make
rdt = tiny_sensor:make
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a package with drivers, as pip would."""
    (tmp_path / "tiny_sensor.py").write_text(TINY)
    about = tmp_path / "tiny_sensor-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: tiny-sensor\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(tmp_path)


def cell_of(driver: str, role: str = "driver") -> CellConfig:
    """Return a cell with this driver."""
    return load_cell(REAL_CELL, {"sensor.driver": driver, "roles.sensor": role})


@pytest.mark.usefixtures("package")
def test_a_driver_of_another_package_plays_the_sensor() -> None:
    """Without a change of ours: the service publishes its samples and its serial number."""
    cell = cell_of("tiny")
    bench = Bench("sensor", SensorDriver, cell=cell, step_s=0.002)
    reader = bench.watch(topics.SENSOR_WRENCH)
    bench.step(5)
    message = reader.read(bench.clock.now_ns()).fresh
    assert message is not None
    assert message.force_N == (1.0, 2.0, cell.sensor.force_range_N)
    assert (message.serial, message.counter) == ("T1", 5)


@pytest.mark.parametrize("name", OURS)
@pytest.mark.usefixtures("package")
def test_each_row_of_ours_names_a_function_and_cannot_be_taken(name: str) -> None:
    """A row is a text, and nothing else would notice a wrong one."""
    assert installed_drivers()[name].load().__name__ == f"{name}_driver"


@pytest.mark.usefixtures("package")
def test_a_driver_that_is_not_installed_or_cannot_be_loaded_is_refused() -> None:
    """With those that are, by the check of a cell file and at the start; or with the reason."""
    cell = cell_of("tinny")
    mistake = unknown_driver(cell)
    assert "'tinny' is not installed here, installed: absent, bota, rdt, robotiq, tiny" in mistake
    with pytest.raises(ConfigError, match="'tinny' is not installed here"):
        driver_of(cell, stale_after_s=0.02)
    assert unknown_driver(cell_of("tinny", role="external")) == ""
    with pytest.raises(ConfigError, match="absent cannot be loaded: No module named"):
        driver_of(cell_of("absent"), stale_after_s=0.02)

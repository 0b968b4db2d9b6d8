"""Soak test of the sensor driver: a thousand records a second over UDP, with loss accounting.

The simulated Net F/T, the hub and the driver run as processes; this one reads the topic as every
service does, the newest message only.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from bench.harness import Options, Tables
from bench.results import ROOT, Row
from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.runtime.realtime import prepare_realtime
from forcemesh import topics
from forcemesh.bus import Reader
from forcemesh.errors import BusError
from forcemesh.messages import Health, SensorWrench
from launch.processes import Supervisor
from launch.started_process import ProcessSpec
from tests.chaos.common_net import free_port
from tests.chaos.witness import witness

RATE_HZ = 1000
MOST_SUPERSEDED = 0.005  # of what was published
MINUTES, PRINT_EVERY_S, WARM_UP_S, START_WITHIN_S = 10.0, 60.0, 2.0, 30.0
NAMES = {
    "records": "records read by the driver from its socket",
    "lost": "lost between sensor and driver",
    "late": "dropped because of their age",
    "stalled": "due while an idle witness saw the machine stand still",
    "published": "published",
    "received": "received by a reader of the newest message only",
    "superseded": "superseded there",
    "not valid": "messages that were not valid",
}


class Soak:
    """A reader of the driver's topic and health, on a cell that is up."""

    def __init__(self, wrench: Reader[SensorWrench], health: Reader[Health]) -> None:
        """Wait for the first sample. Raises BusError when there is none."""
        self._wrench, self._health, self._seq, self._not_valid = wrench, health, 0, 0
        give_up_s = time.monotonic() + START_WITHIN_S
        while wrench.read(time.monotonic_ns()).fresh is None:
            if time.monotonic() > give_up_s:
                raise BusError(f"no sample within {START_WITHIN_S:g} s")
            wrench.wait(0.05)

    def live(self, duration_s: float) -> None:
        """Read as a service does: wait for a message, take the newest."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self._wrench.wait(0.05)
            reading = self._wrench.read(time.monotonic_ns())
            if reading.header is not None and reading.header.seq != self._seq:
                self._seq = reading.header.seq
                self._not_valid += bool(reading.code)

    def counts(self) -> Counter[str]:
        """Return both ends' counters; the driver's are a quarter of a second old at most."""
        health, counters = self._health.read(time.monotonic_ns()).message, self._wrench.counters
        here = {"received": counters.received, "superseded": counters.superseded}
        driver = {} if health is None else health.counters
        return Counter({**driver, **here, "not valid": self._not_valid})


def soak_cell() -> CellConfig:
    """Return a cell whose sensor is on free ports of this machine."""
    ports = [free_port() for _ in range(3)]
    return load_cell(
        ROOT / "cells" / "rs007l-real.yaml",
        {
            "cell": f"soak-{ports[0]}",
            "bus.endpoint": f"tcp/127.0.0.1:{ports[0]}",
            "rates.sensor_hz": RATE_HZ,
            "sensor.address": "127.0.0.1",
            "sensor.port": ports[1],
            "sensor.page_port": ports[2],
            "sensor.calibration": "page",
            "sensor.force_range_N": 500.0,
            "sensor.torque_range_Nm": 20.0,
        },
    )


def processes_of(cell: CellConfig) -> list[ProcessSpec]:
    """Return hub, sensor and driver."""
    ports = ("--port", str(cell.sensor.port), "--page-port", str(cell.sensor.page_port))
    netft = (sys.executable, "-m", "sim.netft", *ports, "--rate-hz", str(RATE_HZ))
    return [
        ProcessSpec("services.hub", ("hub",)),
        ProcessSpec("sim.netft", ("netft",), argv=netft),
        ProcessSpec("services.sensor", ("sensor",)),
    ]


def soak(minutes: float) -> Counter[str]:
    """Run for a duration; return the counts after the warm-up."""
    cell = soak_cell()
    with (
        tempfile.TemporaryDirectory() as folder,
        Supervisor(cell, processes=processes_of(cell)),
        open_bus(cell, topics.CLIENT, patience_s=10.0) as bus,
        witness(Path(folder)) as watch,
    ):
        run = Soak(bus.reader(topics.SENSOR_WRENCH), bus.reader(topics.HEALTH["sensor"]))
        prepare_realtime()
        run.live(WARM_UP_S)
        before, end_s = run.counts(), time.monotonic() + 60.0 * minutes
        while (left_s := end_s - time.monotonic()) > 0.0:
            run.live(min(PRINT_EVERY_S, left_s))
            now = run.counts()
            sys.stderr.write(f"{now['records']} records, {now['superseded']} superseded\n")
        counts = run.counts()
        counts.subtract(before)
        return counts + Counter(stalled=round(RATE_HZ * watch.stalled_s()))


def measure(options: Options) -> Tables:
    """Count for ten minutes."""
    return {"counts": rows(soak(options.minutes or MINUTES))}


def rows(counts: Counter[str]) -> Iterator[Row]:
    """Yield the counts: nothing may be lost, none late but in stalls, few messages superseded."""
    few = MOST_SUPERSEDED * counts["published"]
    met = {
        "records": ("> 0", counts["records"] > 0),
        "lost": ("0", counts["lost"] == 0),
        "late": (str(counts["stalled"]), counts["late"] <= counts["stalled"]),
        "superseded": (f"{few:.0f}", counts["superseded"] <= few),
    }
    for name, text in NAMES.items():
        limit, is_met = met.get(name, ("", None))
        yield {"quantity": text, "count": counts[name], "limit": limit, "met": is_met}

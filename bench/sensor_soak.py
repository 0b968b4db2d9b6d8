"""Soak test of the sensor driver: a thousand records a second over UDP, with loss accounting.

`python -m bench.sensor_soak --minutes 10`: the simulated Net F/T, the hub and the driver run as
processes; this one reads the topic as every service does, the newest message only.
"""

import argparse
import socket
import sys
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import dump_cell, load_cell
from common.runtime.realtime import prepare_realtime
from forcemesh import topics
from forcemesh.bus import Reader
from forcemesh.errors import BusError
from forcemesh.messages import Health, SensorWrench
from launch.processes import Supervisor
from launch.started_process import ProcessSpec

ROOT = Path(__file__).resolve().parent.parent
RATE_HZ = 1000
MOST_SUPERSEDED = 0.005  # of what was published
PRINT_EVERY_S = 60.0
WARM_UP_S = 2.0
START_WITHIN_S = 30.0
COUNTS = ("records", "lost", "late", "published", "received", "superseded", "not_valid")


@dataclass(slots=True)
class SoakCounts:
    """Counters of both ends at one time."""

    records: int = 0
    lost: int = 0
    late: int = 0
    published: int = 0
    received: int = 0
    superseded: int = 0
    not_valid: int = 0
    reasons: dict[str, int] = field(default_factory=dict)


class Soak:
    """A reader of the driver's topic and health, on a cell that is up."""

    def __init__(self, wrench: Reader[SensorWrench], health: Reader[Health]) -> None:
        """Start with the present counters."""
        self._wrench, self._health = wrench, health
        self.soak_counts = SoakCounts()
        self._seq = 0

    def live(self, duration_s: float) -> None:
        """Read as a service does: wait for a message, take the newest."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self._wrench.wait(0.05)
            reading = self._wrench.read(time.monotonic_ns())
            if reading.header is None or reading.header.seq == self._seq:
                continue
            self._seq = reading.header.seq
            if reading.code:
                self.soak_counts.not_valid += 1
                self.soak_counts.reasons[reading.code] = (
                    self.soak_counts.reasons.get(reading.code, 0) + 1
                )

    def wait_until_good(self) -> None:
        """Wait for the first sample; raise BusError when there is none."""
        give_up_s = time.monotonic() + START_WITHIN_S
        while self._wrench.read(time.monotonic_ns()).fresh is None:
            if time.monotonic() > give_up_s:
                raise BusError(f"no sample within {START_WITHIN_S:g} s")
            self._wrench.wait(0.05)

    def count(self) -> SoakCounts:
        """Return both ends' counters; the driver's are a quarter of a second old at most."""
        soak_counts, counters = self.soak_counts, self._wrench.counters
        soak_counts.received, soak_counts.superseded = counters.received, counters.superseded
        health = self._health.read(time.monotonic_ns()).message
        driver = {} if health is None else health.counters
        soak_counts.records, soak_counts.lost = driver.get("records", 0), driver.get("lost", 0)
        soak_counts.late, soak_counts.published = driver.get("late", 0), driver.get("published", 0)
        return soak_counts


def soak_cell() -> CellConfig:
    """Return a cell whose sensor is on free ports of this machine."""
    ports = [_free_port() for _ in range(3)]
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


def soak(minutes: float) -> SoakCounts:
    """Run for a duration; return the counts after the warm-up."""
    cell = soak_cell()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.yaml"
        path.write_text(dump_cell(cell), encoding="utf-8")
        with (
            Supervisor(cell, path, processes=processes_of(cell)),
            open_bus(cell, topics.CLIENT, patience_s=10.0) as bus,
        ):
            run = Soak(bus.reader(topics.SENSOR_WRENCH), bus.reader(topics.HEALTH["sensor"]))
            run.wait_until_good()
            prepare_realtime()
            run.live(WARM_UP_S)
            end_s = time.monotonic() + 60.0 * minutes
            run.soak_counts = SoakCounts()
            before = replace(run.count())
            while (left_s := end_s - time.monotonic()) > 0.0:
                run.live(min(PRINT_EVERY_S, left_s))
                now = run.count()
                sys.stderr.write(
                    f"{now.records} records, {now.lost} lost, {now.superseded} superseded\n"
                )
            return _since(before, run.count())


def _plain(soak_counts: SoakCounts) -> dict[str, int]:
    return {name: getattr(soak_counts, name) for name in COUNTS}


def _since(before: SoakCounts, after: SoakCounts) -> SoakCounts:
    earlier = _plain(before)
    counts: dict[str, Any] = {
        name: number - earlier[name] for name, number in _plain(after).items()
    }
    return replace(after, **counts)


def table(soak_counts: SoakCounts, minutes: float) -> Table:
    """Return the table of counts."""
    rows = Table(title=f"{minutes:g} minutes at {RATE_HZ} Hz over UDP", title_justify="left")
    rows.add_column("quantity")
    rows.add_column("count", justify="right")
    share = soak_counts.superseded / max(soak_counts.published, 1)
    rows.add_row("records read by the driver from its socket", str(soak_counts.records))
    rows.add_row("lost between sensor and driver", str(soak_counts.lost))
    rows.add_row("dropped because of their age", str(soak_counts.late))
    rows.add_row("published", str(soak_counts.published))
    rows.add_row("received by a reader of the newest message only", str(soak_counts.received))
    rows.add_row("superseded there", f"{soak_counts.superseded} ({share:.3%})")
    reason_counts = ", ".join(f"{code}: {count}" for code, count in soak_counts.reasons.items())
    rows.add_row("messages that were not valid", f"{soak_counts.not_valid} {reason_counts}".strip())
    return rows


def is_good(soak_counts: SoakCounts) -> bool:
    """Return whether nothing was lost and few messages were superseded."""
    few = soak_counts.superseded <= MOST_SUPERSEDED * soak_counts.published
    return soak_counts.records > 0 and soak_counts.lost == 0 and soak_counts.late == 0 and few


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
        return port


def main() -> None:
    """Run the test, print the table, exit with 1 on failure."""
    parser = argparse.ArgumentParser(prog="python -m bench.sensor_soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    minutes = parser.parse_args().minutes
    soak_counts = soak(minutes)
    Console().print(table(soak_counts, minutes))
    sys.exit(0 if is_good(soak_counts) else 1)


if __name__ == "__main__":
    main()

"""Checks of this PC and its sensor: versions, clock, ports, priority, calibration, stream."""

import datetime as dt
import os
import platform
import socket
import statistics
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from cli.doctor.checks import ReportLine, finding, passed, skipped
from common.config.calibration import CalibrationSection
from common.config.cell import CellConfig
from common.config.cell_sensor import SensorSection
from common.runtime.realtime import PRIORITY
from forcemesh.messages import Health
from forcemesh.version import __version__
from forcemesh.zenoh_settings import endpoint_of
from services.sensor.driver_registry import unknown_driver
from services.sensor.rdt import RdtCommand, RdtRecord, parse, request
from services.sensor.rdt_status import is_good, status_text
from services.wrench.active_calibration import active_calibration, initial_calibration

PACKAGES = ("eclipse-zenoh", "msgpack", "msgspec", "numpy", "pin", "pydantic")
PROBE_SLEEPS = 50
PROBE_SLEEP_S = 0.001
BUSY_ABOVE = 0.7  # of what there is: bursts and other work need the rest
LATE_WAKE_S = 0.01  # half of the shortest deadline
OLDEST_YEAR = 2024  # a clock that was never set starts in 1970
OLD_DAYS = 365
SENSOR_LISTEN_S = 0.5
DRIVER_PACKAGES = {"robotiq": "serial", "bota": "bota_driver"}


def machine_lines(cell: "CellConfig", *, is_up: bool) -> list[ReportLine]:
    """Return the lines for this PC and this cell's files; takes a tenth of a second."""
    return [
        check_versions(_versions()),
        check_clock(_sleeps_s(), dt.datetime.now(dt.UTC)),
        check_priority(is_granted=can_set_realtime_priority()),
        check_ports(_ports_in_use(cell), is_up=is_up),
        check_calibration(cell, dt.datetime.now(dt.UTC)),
    ]


# --- pure -----------------------------------------------------------------------------------------


def check_versions(found: dict[str, str]) -> ReportLine:
    """Check the installed versions; a missing library was not installed."""
    text = ", ".join(f"{name} {number or 'missing'}" for name, number in found.items())
    if not all(found.values()):
        return finding("versions", "FAIL", text, "versions")
    return passed("versions", text)


def check_clock(sleeps_s: list[float], now: dt.datetime) -> ReportLine:
    """Check how exactly this PC can wait, and whether its date was ever set."""
    longest_s = max(sleeps_s)
    found = (
        f"a wait of {1e3 * PROBE_SLEEP_S:g} ms takes {1e3 * statistics.median(sleeps_s):.1f} ms, "
        f"at most {1e3 * longest_s:.1f}; date {now:%Y-%m-%d %H:%M} UTC"
    )
    if now.year < OLDEST_YEAR:
        return finding("clock", "WARN", found, "clock.calendar")
    if longest_s > LATE_WAKE_S:
        return finding("clock", "WARN", found, "clock.late")
    return passed("clock", found)


def check_priority(*, is_granted: bool) -> ReportLine:
    """Check whether the services get real-time priority."""
    if is_granted:
        return passed("real-time priority", f"granted: SCHED_FIFO {PRIORITY}")
    found = (
        "not granted: CPU load can delay a message past its deadline; the arm then holds. Short "
        "time slices are requested instead (from Linux 6.12 on)"
    )
    return finding("real-time priority", "WARN", found, "priority")


def check_processor(health: Mapping[str, Health], cores: int, limit: float) -> ReportLine:
    """Check whether the processes of a cell leave room, and the real-time ones to the kernel.

    Args:
        health: Of each process on this PC, by its role.
        cores: Of this PC.
        limit: Share of a core that the kernel allows real-time processes.
    """
    used = {role: each.numbers.get("processor_fraction", 0.0) for role, each in health.items()}
    realtime = sum(used[role] for role, each in health.items() if each.counters.get("realtime"))
    text = f"the cell uses {sum(used.values()):.2f} of {cores} cores, {realtime:.2f} in real time"
    found = f"{text}; the kernel allows {limit:.2f} of each"
    if realtime > BUSY_ABOVE * limit * cores or max(used.values(), default=0.0) > BUSY_ABOVE:
        return finding("processor", "WARN", found, "processor")
    return passed("processor", found)


def check_ports(in_use: dict[str, bool], *, is_up: bool) -> ReportLine:
    """Check that the ports of the cell are free; while it is up, its own hub uses them."""
    names = ", ".join(in_use)
    if not in_use:
        return skipped("ports", "the cell uses no port of this PC")
    if is_up:
        return skipped("ports", f"{names}: the cell is up")
    held = [name for name, is_in_use in in_use.items() if is_in_use]
    if held:
        found = f"{', '.join(held)}: another program listens there"
        return finding("ports", "FAIL", found, "ports")
    return passed("ports", f"{names}: free")


def check_calibration(cell: "CellConfig", now: dt.datetime) -> ReportLine:
    """Check whether payload and bias are known, match this tool, and are recent."""
    found = cell.calibration
    if not isinstance(found, CalibrationSection):
        if objection := initial_calibration(cell).objection:
            return finding("calibration", "FAIL", objection, "calibration")
        if cell.payload.weighs:
            return passed("calibration", f"the cell file's payload, {cell.payload.mass_kg:g} kg")
        return finding("calibration", "WARN", "none, and the cell accepts that", "calibration")
    days = (now - found.made_at).days
    text = f"revision {found.revision}, {days} days old, tool {found.tool or 'without a name'}"
    if objection := active_calibration(found, cell).objection:
        return finding("calibration", "FAIL", f"{text}: {objection}", "calibration")
    if days > OLD_DAYS:
        return finding("calibration", "WARN", text, "calibration.old")
    return passed("calibration", text)


# --- probes ---------------------------------------------------------------------------------------


def can_set_realtime_priority() -> bool:
    """Try to set real-time priority, in a thread that ends with it."""
    granted = False

    def attempt() -> None:
        nonlocal granted
        try:
            os.sched_setscheduler(
                threading.get_native_id(), os.SCHED_FIFO, os.sched_param(PRIORITY)
            )
        except (AttributeError, OSError):
            return
        granted = True

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return granted


def realtime_limit(folder: Path = Path("/proc/sys/kernel")) -> float:
    """Return the share of a core that the kernel allows real-time processes; 1 without a limit."""
    try:
        runtime, period = (
            int((folder / f"sched_rt_{word}_us").read_text("ascii"))
            for word in ("runtime", "period")
        )
    except (OSError, ValueError):
        return 1.0
    return 1.0 if runtime < 0 else runtime / period


def _versions() -> dict[str, str]:
    found = {"forcemesh": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    return found


def _sleeps_s() -> list[float]:
    """Return the measured durations of short sleeps [s]."""
    took_s = []
    for _ in range(PROBE_SLEEPS):
        began_s = time.monotonic()
        time.sleep(PROBE_SLEEP_S)
        took_s.append(time.monotonic() - began_s)
    return took_s


def _ports_in_use(cell: "CellConfig") -> dict[str, bool]:
    """Return the listen addresses of the cell on this PC, and whether each is in use."""
    endpoint = endpoint_of(cell)
    host, _, port = endpoint.partition("/")[2].partition("?")[0].rpartition(":")
    if not port.isdigit() or not is_local(host):
        return {}
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host.strip("[]"), int(port)))
        except OSError:
            return {endpoint: True}
    return {endpoint: False}


def is_local(host: str) -> bool:
    """Return whether an address is one of this PC's own, without a name lookup."""
    return host.strip("[]") in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "::")  # noqa: S104


# --- sensor ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ReceivedStream:
    """Records received from a sensor after a stream request."""

    records: int
    newest: RdtRecord | None
    error_text: str = ""  # error text of the system


def sensor_line(cell: "CellConfig", *, is_up: bool) -> ReportLine:
    """Check the cell's sensor unless the cell is up: it streams to its last client only."""
    implementation, sensor = cell.roles.sensor, cell.sensor
    if implementation != "driver":
        return skipped("sensor", f"not used by this cell: roles.sensor is {implementation}")
    if is_up:
        return skipped("sensor", "the cell is up and uses the only stream: see sensor/wrench")
    if sensor.driver == "rdt":
        endpoint = f"{sensor.address}:{sensor.port}"
        return check_stream_of(
            endpoint, listen(sensor.address, sensor.port, SENSOR_LISTEN_S), SENSOR_LISTEN_S
        )
    if mistake := unknown_driver(cell):
        return finding("sensor", "FAIL", mistake, "sensor.driver")
    if sensor.driver not in DRIVER_PACKAGES:
        return passed("sensor", f"{sensor.driver}: installed; the sensor was not opened")
    has_package = bool(find_spec(DRIVER_PACKAGES[sensor.driver]))
    return check_device(sensor, exists=Path(sensor.device).exists(), has_package=has_package)


def check_stream_of(endpoint: str, found: ReceivedStream, listened_s: float) -> ReportLine:
    """Check the records of a sensor on the network."""
    if found.newest is None:
        detail = found.error_text or f"no record in {listened_s:g} s"
        return finding("sensor", "FAIL", f"{endpoint}: {detail}", "sensor.silent")
    text = f"{endpoint}: {found.records / listened_s:.0f} records/s"
    if not is_good(found.newest.status):
        status_line = f"{text}, status: {status_text(found.newest.status)}"
        return finding("sensor", "FAIL", status_line, "sensor.status")
    return passed("sensor", text)


def check_device(sensor: "SensorSection", *, exists: bool, has_package: bool) -> ReportLine:
    """Check whether a sensor on a serial line can be opened."""
    if not has_package:
        found = f"driver {sensor.driver} needs the package {DRIVER_PACKAGES[sensor.driver]}"
        return finding("sensor", "FAIL", found, f"sensor.{sensor.driver}")
    if not exists:
        return finding("sensor", "FAIL", f"{sensor.device} does not exist", "sensor.device")
    return passed("sensor", f"{sensor.driver}: {sensor.device} exists; it was not opened")


def listen(address: str, port: int, for_s: float) -> ReceivedStream:
    """Request the stream of a sensor, count its records, stop the stream."""
    records, newest = 0, None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        try:
            line.connect((address, port))
            line.send(request(RdtCommand.START))
            end_s = time.monotonic() + for_s
            while (left_s := end_s - time.monotonic()) > 0.0:
                line.settimeout(left_s)
                record = parse(line.recv(2048))
                if record is not None:
                    records, newest = records + 1, record
        except TimeoutError:
            pass
        except OSError as error:
            return ReceivedStream(records, newest, error.strerror or str(error))
        line.send(request(RdtCommand.STOP))
    return ReceivedStream(records, newest)

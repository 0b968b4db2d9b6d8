"""Checks of this PC by `forcemesh doctor`: versions, clock, ports, priority, calibration."""

import datetime as dt
import os
import platform
import socket
import statistics
import threading
import time
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from cli.doctor.checks import ReportLine, finding, passed, skipped
from common.runtime.realtime import PRIORITY
from forcemesh.version import __version__
from forcemesh.zenoh_settings import endpoint_of

if TYPE_CHECKING:
    from common.config.cell import CellConfig

PACKAGES = ("eclipse-zenoh", "msgpack", "numpy", "pin", "pydantic")
PROBE_SLEEPS = 50
PROBE_SLEEP_S = 0.001
LATE_WAKE_S = 0.01  # half of the shortest deadline
OLDEST_YEAR = 2024  # a clock that was never set starts in 1970
OLD_DAYS = 365


@dataclass(frozen=True, slots=True)
class SleepTimes:
    """Measured durations of short sleeps [s]."""

    median_s: float
    longest_s: float


def machine_lines(cell: "CellConfig", *, is_up: bool) -> list[ReportLine]:
    """Return the lines for this PC and this cell's files; takes a tenth of a second."""
    return [
        check_versions(_versions()),
        check_clock(_sleep_times(), dt.datetime.now(dt.UTC)),
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


def check_clock(sleeps: SleepTimes, now: dt.datetime) -> ReportLine:
    """Check how exactly this PC can wait, and whether its date was ever set."""
    found = (
        f"a wait of {1e3 * PROBE_SLEEP_S:g} ms takes {1e3 * sleeps.median_s:.1f} ms, at most "
        f"{1e3 * sleeps.longest_s:.1f}; date {now:%Y-%m-%d %H:%M} UTC"
    )
    if now.year < OLDEST_YEAR:
        return finding("clock", "WARN", found, "clock.calendar")
    if sleeps.longest_s > LATE_WAKE_S:
        return finding("clock", "WARN", found, "clock.late")
    return passed("clock", found)


def check_priority(*, is_granted: bool) -> ReportLine:
    """Check whether the services get real-time priority."""
    if is_granted:
        return passed("real-time priority", f"granted: SCHED_FIFO {PRIORITY}")
    found = "not granted: CPU load can delay a message past its deadline; the arm then holds"
    return finding("real-time priority", "WARN", found, "priority")


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
    from services.wrench.active_calibration import active_calibration

    found = cell.calibration
    if found is None:
        if cell.payload.weighs:
            return passed("calibration", f"the cell file's payload, {cell.payload.mass_kg:g} kg")
        if cell.payload.accept_uncalibrated:
            return finding("calibration", "WARN", "none, and the cell accepts that", "calibration")
        return finding("calibration", "FAIL", "none, and the payload is zero", "calibration")
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


def _versions() -> dict[str, str]:
    found = {"forcemesh": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    return found


def _sleep_times() -> SleepTimes:
    took_s = []
    for _ in range(PROBE_SLEEPS):
        began_s = time.monotonic()
        time.sleep(PROBE_SLEEP_S)
        took_s.append(time.monotonic() - began_s)
    return SleepTimes(statistics.median(took_s), max(took_s))


def _ports_in_use(cell: "CellConfig") -> dict[str, bool]:
    """Return the listen addresses of the cell on this PC, and whether each is in use."""
    endpoint = endpoint_of(cell)
    found = {}
    host, _, port = endpoint.partition("/")[2].partition("?")[0].rpartition(":")
    if port.isdigit() and is_local(host):
        found[endpoint] = _is_in_use(host.strip("[]"), int(port))
    return found


def is_local(host: str) -> bool:
    """Return whether an address is one of this PC's own, without a name lookup."""
    return host.strip("[]") in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "::")  # noqa: S104


def _is_in_use(host: str, port: int) -> bool:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return True
    return False

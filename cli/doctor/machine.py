"""What `forcemesh doctor` looks at on this PC: versions, clock, ports, priority, calibration."""

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

from cli.doctor.checks import Line, passed, skipped, trouble
from common.runtime.priority import PRIORITY
from forcemesh.version import __version__
from forcemesh.zenoh_settings import endpoint_of

if TYPE_CHECKING:
    from common.config.cell import Cell

PACKAGES = ("eclipse-zenoh", "msgpack", "numpy", "pin", "pydantic")
NAPS = 50
NAP_S = 0.001
LATE_S = 0.01  # half of the shortest deadline
OLDEST_YEAR = 2024  # a clock that was never set says 1970
OLD_DAYS = 365


@dataclass(frozen=True, slots=True)
class Naps:
    """How long short sleeps really took [s]."""

    median_s: float
    longest_s: float


def machine_lines(cell: "Cell", *, is_up: bool) -> list[Line]:
    """Return what is to be said of this PC and this cell's files; takes a tenth of a second."""
    return [
        check_versions(_versions()),
        check_clock(_naps(), dt.datetime.now(dt.UTC)),
        check_priority(is_granted=may_go_first()),
        check_ports(_taken(cell), is_up=is_up),
        check_calibration(cell, dt.datetime.now(dt.UTC)),
    ]


# --- pure -----------------------------------------------------------------------------------------


def check_versions(found: dict[str, str]) -> Line:
    """Tell which versions run here; a library that is missing was not installed."""
    text = ", ".join(f"{name} {number or 'missing'}" for name, number in found.items())
    if not all(found.values()):
        return trouble("versions", "FAIL", text, "versions")
    return passed("versions", text)


def check_clock(naps: Naps, now: dt.datetime) -> Line:
    """Judge how exactly this PC can wait, and whether its calendar was ever set."""
    found = (
        f"a wait of {1e3 * NAP_S:g} ms takes {1e3 * naps.median_s:.1f} ms, at most "
        f"{1e3 * naps.longest_s:.1f}; it is {now:%Y-%m-%d %H:%M} UTC"
    )
    if now.year < OLDEST_YEAR:
        return trouble("clock", "WARN", found, "clock.calendar")
    if naps.longest_s > LATE_S:
        return trouble("clock", "WARN", found, "clock.late")
    return passed("clock", found)


def check_priority(*, is_granted: bool) -> Line:
    """Tell whether the services may go before ordinary processes."""
    if is_granted:
        return passed("real-time priority", f"granted: SCHED_FIFO {PRIORITY}")
    found = "not granted: other work on this PC can make a process late, and the arm holds"
    return trouble("real-time priority", "WARN", found, "priority")


def check_ports(taken: dict[str, bool], *, is_up: bool) -> Line:
    """Tell whether what the cell will listen on is free; while it is up, its own hub is there."""
    names = ", ".join(taken)
    if not taken:
        return skipped("ports", "nothing of this cell listens on this PC")
    if is_up:
        return skipped("ports", f"{names}: the cell is up")
    held = [name for name, is_taken in taken.items() if is_taken]
    if held:
        found = f"{', '.join(held)}: another program listens there"
        return trouble("ports", "FAIL", found, "ports")
    return passed("ports", f"{names}: free")


def check_calibration(cell: "Cell", now: dt.datetime) -> Line:
    """Judge whether payload and bias are known, whether they are of this tool, and how old."""
    from services.wrench.active_calibration import of_calibration

    found = cell.calibration
    if found is None:
        if cell.payload.weighs:
            return passed("calibration", f"the cell file's payload, {cell.payload.mass_kg:g} kg")
        if cell.payload.accept_uncalibrated:
            return trouble("calibration", "WARN", "none, and the cell accepts that", "calibration")
        return trouble("calibration", "FAIL", "none, and the payload is zero", "calibration")
    days = (now - found.made_at).days
    text = f"revision {found.revision}, {days} days old, tool {found.tool or 'without a name'}"
    if objection := of_calibration(found, cell).objection:
        return trouble("calibration", "FAIL", f"{text}: {objection}", "calibration")
    if days > OLD_DAYS:
        return trouble("calibration", "WARN", text, "calibration.old")
    return passed("calibration", text)


# --- probes ---------------------------------------------------------------------------------------


def may_go_first() -> bool:
    """Try to take real-time priority, in a thread that ends with it."""
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


def _naps() -> Naps:
    took_s = []
    for _ in range(NAPS):
        began_s = time.monotonic()
        time.sleep(NAP_S)
        took_s.append(time.monotonic() - began_s)
    return Naps(statistics.median(took_s), max(took_s))


def _taken(cell: "Cell") -> dict[str, bool]:
    """Return the addresses on this PC that the cell listens on, and whether somebody does now."""
    endpoint = endpoint_of(cell)
    found = {}
    host, _, port = endpoint.partition("/")[2].partition("?")[0].rpartition(":")
    if port.isdigit() and is_local(host):
        found[endpoint] = _is_taken(host.strip("[]"), int(port))
    return found


def is_local(host: str) -> bool:
    """Tell whether an address is one of this PC's own that can be tried without asking anybody."""
    return host.strip("[]") in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "::")  # noqa: S104


def _is_taken(host: str, port: int) -> bool:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return True
    return False

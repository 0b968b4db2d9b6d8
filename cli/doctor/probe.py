"""Checks of a cell against the probe of its controller: switches, programs, segments, lines."""

from collections.abc import Iterator
from datetime import UTC, datetime

from cli.doctor.checks import ReportLine, finding, passed
from common.config.cell import CellConfig
from common.config.probe import ProbeFile

OLD_DAYS = 365
PROGRAM_SLOTS = (1, 2, 3)  # of forcemesh.as


def probe_lines(cell: CellConfig, probe: ProbeFile, *, now: datetime) -> list[ReportLine]:
    """Return what the probe of the cell's controller shows.

    Args:
        cell: The cell, with the values of the probe in its section robot.
        probe: Content of the file that the cell file names as `robot.probe`.
        now: The time, with its zone.
    """
    lines = [_age(probe, now), *_address(cell, probe)]
    if probe.lines:
        lines.append(_lines(probe))
    lines += [*_switches(probe), *_slots(probe)]
    if cell.roles.robot == "gateway":
        lines.append(_segments(cell, probe))
    if probe.number("behaviour.tcp_error_stands"):
        lines.append(
            finding("TCP errors", "WARN", "a lost connection stands as an error", "probe.tcp")
        )
    return lines


def _age(probe: ProbeFile, now: datetime) -> ReportLine:
    stages = ", ".join(probe.stages) or "none"
    text = f"stages {stages}; {probe.controller or 'controller not named'}"
    if probe.measured_at is None:
        return finding("probe", "WARN", f"no date; {text}", "probe.old")
    measured = probe.measured_at
    days = (now - (measured if measured.tzinfo else measured.replace(tzinfo=UTC))).days
    text = f"{days} days old; {text}"
    if days > OLD_DAYS:
        return finding("probe", "WARN", text, "probe.old")
    if "c" not in probe.stages:
        return finding("probe", "WARN", text, "probe.motion")
    return passed("probe", text)


def _address(cell: CellConfig, probe: ProbeFile) -> Iterator[ReportLine]:
    """Compare the address of the controller that was measured with that of the cell."""
    if cell.gateway is None or not probe.address:
        return
    address = f"{cell.gateway.host}:{cell.gateway.port}"
    if probe.address == address:
        yield passed("probe address", address)
    else:
        found = f"measured at {probe.address}; the cell file has {address}"
        yield finding("probe address", "WARN", found, "probe.address")


def _lines(probe: ProbeFile) -> ReportLine:
    names = ", ".join(probe.differing)
    if names:
        return finding("AS lines", "FAIL", f"another result than expected: {names}", "probe.lines")
    return passed("AS lines", f"{len(probe.lines)} of forcemesh.as give what they must")


def _switches(probe: ProbeFile) -> Iterator[ReportLine]:
    """Yield a warning for each switch that surprises, when the probe has read it."""
    for switch, remedy, surprise in (
        ("abs.speed", "probe.abs.speed", "the monitor speed does not scale MM/S"),
        ("qtool", "probe.qtool", "operation on the pendant replaces TOOL"),
        ("errstart.pc", "probe.errstart", "an error starts a fifth PC program"),
        ("slow_start", "probe.slow_start", "the first motion after a start is slow"),
    ):
        state = probe.number(f"switch.{switch}")
        if state is None:
            continue
        name = switch.upper()
        if state:
            yield finding(name, "WARN", f"ON: {surprise}", remedy)
        else:
            yield passed(name, "OFF")


def _slots(probe: ProbeFile) -> Iterator[ReportLine]:
    taken = [slot for slot in PROGRAM_SLOTS if probe.number(f"task.{slot}")]
    if taken:
        names = ", ".join(map(str, taken))
        found = f"{names}: in use before forcemesh.as was loaded"
        yield finding("PC programs", "WARN", found, "probe.slots")


def _segments(cell: CellConfig, probe: ProbeFile) -> ReportLine:
    """Compare the interval of set points with the shortest segment that was planned in time."""
    least_s = probe.gateway.least_segment_s
    period_s = 1.0 / cell.rates.robot_hz
    if least_s is None:
        return passed("least segment", "not measured, see the probe; the cell file's holds")
    found = f"{1e3 * least_s:.0f} ms; set points every {1e3 * period_s:.0f} ms"
    if period_s < least_s:
        return finding("least segment", "WARN", found, "probe.segment")
    return passed("least segment", found)

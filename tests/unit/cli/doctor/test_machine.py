"""What `forcemesh doctor` says of this PC and of the sensor: each finding with its remedy."""

import datetime as dt
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cli.doctor.checks import ObservedRole, ReportLine, check_role
from cli.doctor.machine import (
    SleepTimes,
    check_calibration,
    check_clock,
    check_ports,
    check_priority,
    check_versions,
    is_local,
    machine_lines,
)
from cli.doctor.sensor import ReceivedStream, check_device, check_stream_of, listen, sensor_line
from common.config.calibration import CalibrationSection, PayloadSection, Residuals
from common.config.cell import CellConfig
from common.config.load import load_cell
from services.sensor.rdt import RECORD, REQUEST, RdtCommand, RdtRecord

CELLS = Path(__file__).resolve().parents[4] / "cells"
DEMO, NETFT = load_cell(CELLS / "demo.yaml"), load_cell(CELLS / "demo-netft.yaml")
REAL = load_cell(CELLS / "rs007l-real.yaml")
NOW = dt.datetime(2026, 11, 1, tzinfo=dt.UTC)
GOOD = RdtRecord(1, 1, 0, (0,) * 6)


def judged(line: ReportLine) -> tuple[str, bool]:
    """The word of a line, and whether it says what to do."""
    return line.result, bool(line.remedy)


def calibrated(cell: CellConfig, days: int, **changes: Any) -> CellConfig:
    """The cell with a calibration made so many days ago."""
    residuals = Residuals(
        poses=8, force_mean_N=0.1, force_max_N=0.2, torque_mean_Nm=0.01, torque_max_Nm=0.02
    )
    found: dict[str, Any] = {
        "cell": cell.cell,
        "made_at": NOW - dt.timedelta(days=days),
        "method": "arm",
        "tool": cell.tool.name,
        "T_flange_tcp": cell.tool.T_flange_tcp,
        "T_flange_sensor": cell.sensor.T_flange_sensor,
        "fit": residuals,
        "verified": residuals,
        "payload": PayloadSection(mass_kg=0.5, com_m=(0.0, 0.0, 0.05)),
    }
    return cell.model_copy(update={"calibration": CalibrationSection(**(found | changes))})


def test_every_item_has_a_line() -> None:
    """Versions, clock, priority, ports, calibration: whatever this machine is like."""
    lines = {line.check: line for line in machine_lines(DEMO, is_up=False)}
    assert list(lines) == ["versions", "clock", "real-time priority", "ports", "calibration"]
    for line in lines.values():
        assert line.result in ("PASS", "SKIP") or line.remedy


def test_a_missing_library_is_a_failure() -> None:
    """It is named."""
    assert judged(check_versions({"Python": "3.11", "numpy": "2.2"})) == ("PASS", False)
    line = check_versions({"Python": "3.11", "numpy": ""})
    assert judged(line) == ("FAIL", True)
    assert "numpy missing" in line.found


def test_a_clock_that_is_late_or_was_never_set_is_a_warning() -> None:
    """Late by half a deadline; of 1970."""
    quick, late = SleepTimes(0.0011, 0.002), SleepTimes(0.0011, 0.05)
    assert judged(check_clock(quick, NOW)) == ("PASS", False)
    assert judged(check_clock(late, NOW)) == ("WARN", True)
    assert judged(check_clock(quick, NOW.replace(year=1970))) == ("WARN", True)


def test_priority_that_is_not_granted_is_a_warning() -> None:
    """The cell works without, until the machine is busy."""
    assert judged(check_priority(is_granted=True)) == ("PASS", False)
    assert judged(check_priority(is_granted=False)) == ("WARN", True)


def test_a_port_that_somebody_else_has_is_a_failure() -> None:
    """While the cell is up it is the cell that has it."""
    taken = {"tcp/127.0.0.1:7447": True}
    assert judged(check_ports(taken, is_up=False)) == ("FAIL", True)
    assert judged(check_ports(taken, is_up=True)) == ("SKIP", False)
    assert judged(check_ports({"tcp/127.0.0.1:7447": False}, is_up=False)) == ("PASS", False)
    assert judged(check_ports({}, is_up=False)) == ("SKIP", False)


@pytest.mark.realtime
def test_a_listener_on_the_hubs_port_is_seen() -> None:
    """By trying to bind, which asks nobody."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        where = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        cell = load_cell(CELLS / "demo.yaml", {"bus.endpoint": where})
        words = {line.check: line.result for line in machine_lines(cell, is_up=False)}
    assert words["ports"] == "FAIL"
    assert is_local("127.0.0.1")
    assert not is_local("labpc.example")


def test_a_calibration_is_judged_by_tool_and_age() -> None:
    """None at all; the cell file's own numbers; fresh; old; of another tool."""
    assert judged(check_calibration(REAL, NOW)) == ("FAIL", True)
    assert judged(check_calibration(DEMO, NOW)) == ("PASS", False)
    assert judged(check_calibration(calibrated(REAL, 3), NOW)) == ("PASS", False)
    assert judged(check_calibration(calibrated(REAL, 400), NOW)) == ("WARN", True)
    for changes in ({"tool": "another"}, {"verified": None}):
        other = check_calibration(calibrated(REAL, 3, **changes), NOW)
        assert judged(other) == ("FAIL", True)
    accepted = REAL.model_copy(
        update={"payload": REAL.payload.model_copy(update={"accept_uncalibrated": True})}
    )
    assert judged(check_calibration(accepted, NOW)) == ("WARN", True)


def test_a_process_of_another_version_is_a_failure() -> None:
    """The arbiter would refuse to arm; here is the remedy."""
    line = check_role(ObservedRole("wrench", 0.1, is_fresh=True, version="0.0.1"))
    assert judged(line) == ("FAIL", True)
    assert "version 0.0.1" in line.found


def test_a_sensor_that_is_not_ours_to_try_is_left_alone() -> None:
    """A simulated one; and one whose only stream the cell has."""
    assert sensor_line(DEMO, is_up=False).result == "SKIP"
    assert sensor_line(NETFT, is_up=True).result == "SKIP"


def test_what_a_sensor_sends_is_judged() -> None:
    """Nothing; an error; readings."""
    assert judged(check_stream_of("there", ReceivedStream(0, None), 0.5)) == ("FAIL", True)
    bad = RdtRecord(1, 1, 0x80000001, (0,) * 6)
    assert judged(check_stream_of("there", ReceivedStream(9, bad), 0.5)) == ("FAIL", True)
    line = check_stream_of("there", ReceivedStream(500, GOOD), 0.5)
    assert (line.result, "1000 records/s" in line.found) == ("PASS", True)


def test_a_sensor_on_a_line_of_its_own_is_looked_for() -> None:
    """The package first, then the device."""
    for driver in ("robotiq", "bota"):
        sensor = REAL.sensor.model_copy(update={"driver": driver})
        assert check_device(sensor, exists=True, has_package=True).result == "PASS"
        assert judged(check_device(sensor, exists=False, has_package=True)) == ("FAIL", True)
        missing = check_device(sensor, exists=True, has_package=False)
        assert f"forcemesh[{driver}]" in missing.remedy


@pytest.fixture
def netft() -> Iterator[tuple[int, list[int]]]:
    """A sensor that sends twenty records when asked, and what it was asked for."""
    asked: list[int] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(20.0)

        def serve() -> None:
            for _ in range(2):
                data, peer = server.recvfrom(64)
                asked.append(REQUEST.unpack(data)[1])
                if asked[-1] == RdtCommand.START:
                    for number in range(20):
                        server.sendto(RECORD.pack(number, number, 0, *[0] * 6), peer)

        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname()[1], asked
        thread.join()
        assert asked == [RdtCommand.START, RdtCommand.STOP]


@pytest.mark.realtime
def test_the_sensor_is_asked_and_told_to_stop(netft: tuple[int, list[int]]) -> None:
    """It must not go on sending to a port where nobody listens."""
    port, _ = netft
    found = listen("127.0.0.1", port, 0.5)
    assert (found.records, found.newest is not None) == (20, True)

"""Checks of `forcemesh doctor` on this PC and the sensor: findings with their remedies."""

import datetime as dt
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cli.doctor.checks import ReportLine, check_role
from cli.doctor.machine import (
    ReceivedStream,
    check_calibration,
    check_clock,
    check_device,
    check_ports,
    check_priority,
    check_processor,
    check_stream_of,
    check_versions,
    is_local,
    listen,
    machine_lines,
    realtime_limit,
    sensor_line,
)
from common.config.calibration import CalibrationSection, Residuals
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.config.payload import Payload
from forcemesh.bus import Reading
from forcemesh.messages import Health
from services.sensor import driver_registry
from services.sensor.rdt import RECORD, REQUEST, RdtCommand, RdtRecord
from tests.fakes.bench import CELL, DEMO

CELLS = DEMO.parent
NETFT = load_cell(CELLS / "demo-netft.yaml")
REAL = load_cell(CELLS / "rs007l-real.yaml")
NOW = dt.datetime(2026, 11, 1, tzinfo=dt.UTC)
GOOD = RdtRecord(1, 1, 0, (0,) * 6)


def judged(line: ReportLine) -> tuple[str, bool]:
    """Return the result of a line, and whether it has a remedy."""
    return line.result, bool(line.remedy)


def calibrated(cell: CellConfig, days: int, **changes: Any) -> CellConfig:
    """Return the cell with a calibration of this age in days."""
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
        "payload": Payload(mass_kg=0.5, com_m=(0.0, 0.0, 0.05)),
    }
    return cell.model_copy(update={"calibration": CalibrationSection(**(found | changes))})


def test_every_item_has_a_line() -> None:
    """Versions, clock, priority, ports and calibration have a line on every machine."""
    lines = {line.check: line for line in machine_lines(CELL, is_up=False)}
    assert list(lines) == ["versions", "clock", "real-time priority", "ports", "calibration"]
    for line in lines.values():
        assert line.result in ("PASS", "SKIP") or line.remedy


def test_a_missing_library_is_a_failure() -> None:
    """The missing library is named."""
    assert judged(check_versions({"Python": "3.11", "numpy": "2.2"})) == ("PASS", False)
    line = check_versions({"Python": "3.11", "numpy": ""})
    assert judged(line) == ("FAIL", True)
    assert "numpy missing" in line.found


def test_a_late_or_unset_clock_is_a_warning() -> None:
    """A clock is late by half a deadline, or shows the year 1970."""
    quick, late = [0.001, 0.0011, 0.002], [0.001, 0.0011, 0.05]
    assert judged(check_clock(quick, NOW)) == ("PASS", False)
    assert judged(check_clock(late, NOW)) == ("WARN", True)
    assert judged(check_clock(quick, NOW.replace(year=1970))) == ("WARN", True)


def test_missing_real_time_priority_is_a_warning() -> None:
    """A cell works without it while the machine is idle."""
    assert judged(check_priority(is_granted=True)) == ("PASS", False)
    assert judged(check_priority(is_granted=False)) == ("WARN", True)


def test_a_port_used_by_another_process_is_a_failure() -> None:
    """While the cell is up, the cell itself uses the port."""
    taken = {"tcp/127.0.0.1:7447": True}
    assert judged(check_ports(taken, is_up=False)) == ("FAIL", True)
    assert judged(check_ports(taken, is_up=True)) == ("SKIP", False)
    assert judged(check_ports({"tcp/127.0.0.1:7447": False}, is_up=False)) == ("PASS", False)
    assert judged(check_ports({}, is_up=False)) == ("SKIP", False)


@pytest.mark.realtime
def test_a_listener_on_the_port_of_the_hub_is_detected() -> None:
    """The check binds the port, without contacting any process."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        where = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        cell = load_cell(CELLS / "demo.yaml", {"bus.endpoint": where})
        words = {line.check: line.result for line in machine_lines(cell, is_up=False)}
    assert words["ports"] == "FAIL"
    assert is_local("127.0.0.1")
    assert not is_local("labpc.example")


def test_a_calibration_is_judged_by_tool_and_age() -> None:
    """Cases: none, the cell file's own numbers, a recent one, an old one, another tool."""
    missing = check_calibration(REAL, NOW)
    assert judged(missing) == ("FAIL", True)
    assert missing.found.startswith("calibrate first")
    assert judged(check_calibration(CELL, NOW)) == ("PASS", False)
    assert judged(check_calibration(calibrated(REAL, 3), NOW)) == ("PASS", False)
    assert judged(check_calibration(calibrated(REAL, 400), NOW)) == ("WARN", True)
    for changes in ({"tool": "another"}, {"verified": None}):
        other = check_calibration(calibrated(REAL, 3, **changes), NOW)
        assert judged(other) == ("FAIL", True)
    accepted = REAL.model_copy(
        update={
            "calibration": "none",
            "payload": REAL.payload.model_copy(update={"accept_uncalibrated": True}),
        }
    )
    assert judged(check_calibration(accepted, NOW)) == ("WARN", True)


def test_a_process_of_another_version_is_a_failure() -> None:
    """The arbiter refuses to arm in this case; the line gives the remedy."""
    line = check_role("wrench", Reading(Health(version="0.0.1"), None, 0.1, ""), "")
    assert judged(line) == ("FAIL", True)
    assert "version 0.0.1" in line.found


def test_a_sensor_that_must_not_be_contacted_is_skipped() -> None:
    """A simulated sensor, and one whose only stream the cell uses."""
    assert sensor_line(CELL, is_up=False).result == "SKIP"
    assert sensor_line(NETFT, is_up=True).result == "SKIP"


def test_the_stream_of_a_sensor_is_judged() -> None:
    """Cases: no record, a record with an error, valid readings."""
    assert judged(check_stream_of("there", ReceivedStream(0, None), 0.5)) == ("FAIL", True)
    bad = RdtRecord(1, 1, 0x80000001, (0,) * 6)
    assert judged(check_stream_of("there", ReceivedStream(9, bad), 0.5)) == ("FAIL", True)
    line = check_stream_of("there", ReceivedStream(500, GOOD), 0.5)
    assert (line.result, "1000 records/s" in line.found) == ("PASS", True)


def test_a_sensor_on_a_serial_device_is_checked_by_package_and_device() -> None:
    """A missing package is reported first, then a missing device."""
    for driver in ("robotiq", "bota"):
        sensor = REAL.sensor.model_copy(update={"driver": driver})
        assert check_device(sensor, exists=True, has_package=True).result == "PASS"
        assert judged(check_device(sensor, exists=False, has_package=True)) == ("FAIL", True)
        missing = check_device(sensor, exists=True, has_package=False)
        assert f"forcemesh[{driver}]" in missing.remedy


def test_a_driver_of_another_package_is_reported_and_an_unknown_one_is_a_failure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The sensor of a driver that is not ours is not opened; the text lists what is installed."""
    cell = load_cell(CELLS / "rs007l-real.yaml", {"sensor.driver": "ftx"})
    line = sensor_line(cell, is_up=False)
    assert judged(line) == ("FAIL", True)
    assert "'ftx' is not installed here, installed: bota, rdt, robotiq" in line.found
    monkeypatch.setitem(driver_registry.OURS, "ftx", "somewhere:make")
    line = sensor_line(cell, is_up=False)
    assert (line.result, line.found) == ("PASS", "ftx: installed; the sensor was not opened")


@pytest.fixture
def netft() -> Iterator[tuple[int, list[int]]]:
    """The port of a sensor that sends twenty records on request, and its received commands."""
    commands: list[int] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(20.0)

        def serve() -> None:
            for _ in range(2):
                data, peer = server.recvfrom(64)
                commands.append(REQUEST.unpack(data)[1])
                if commands[-1] == RdtCommand.START:
                    for number in range(20):
                        server.sendto(RECORD.pack(number, number, 0, *[0] * 6), peer)

        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname()[1], commands
        thread.join()
        assert commands == [RdtCommand.START, RdtCommand.STOP]


@pytest.mark.realtime
def test_the_sensor_is_started_and_stopped(netft: tuple[int, list[int]]) -> None:
    """It must not continue to send to a closed port."""
    port, _ = netft
    found = listen("127.0.0.1", port, 0.5)
    assert (found.records, found.newest is not None) == (20, True)


# --- processor time -------------------------------------------------------------------------------


def using(**shares: float) -> dict[str, Health]:
    """Return the health of processes with real-time priority that use so much of a core."""
    return {
        role: Health(numbers={"processor_fraction": share}, counters={"realtime": 1})
        for role, share in shares.items()
    }


def test_a_cell_leaves_room_on_every_core() -> None:
    """Together within the kernel's limit for real time, and no loop near a whole core."""
    assert judged(check_processor(using(robot=0.6, arbiter=0.7), 2, 0.95)) == ("PASS", False)
    assert judged(check_processor(using(robot=0.7, arbiter=0.7), 2, 0.95)) == ("WARN", True)
    assert judged(check_processor(using(robot=0.7, arbiter=0.7), 4, 0.95)) == ("PASS", False)
    assert judged(check_processor(using(robot=0.8), 8, 0.95)) == ("WARN", True)
    ordinary = {"robot": Health(numbers={"processor_fraction": 0.7})}
    line = check_processor(using(arbiter=0.7) | ordinary, 2, 0.95)
    text = "the cell uses 1.40 of 2 cores, 0.70 in real time; the kernel allows 0.95 of each"
    assert (line.result, line.found) == ("PASS", text)
    assert check_processor({"robot": Health()}, 2, 1.0).result == "PASS"  # of an older version


@pytest.mark.parametrize(("runtime", "limit"), [("950000", 0.95), ("-1", 1.0), ("", 1.0)])
def test_the_kernels_limit_for_real_time_is_read(
    tmp_path: Path, runtime: str, limit: float
) -> None:
    """Minus one means that there is none."""
    (tmp_path / "sched_rt_runtime_us").write_text(runtime)
    (tmp_path / "sched_rt_period_us").write_text("1000000")
    assert realtime_limit(tmp_path) == limit
    assert realtime_limit(tmp_path / "elsewhere") == 1.0

"""Checks of `forcemesh doctor` on this PC, its cores and the sensor, with their remedies."""

import datetime as dt
import multiprocessing as mp
import os
import socket
import threading
from typing import Any

import pytest

from cli.doctor import latency
from cli.doctor.checks import ReportLine, check_role
from cli.doctor.latency import CoreLatency, LatencyCause, check_latency, latency_lines
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
    listen,
    sensor_line,
)
from cli.doctor.remedies import REMEDIES
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh.bus import Reading
from forcemesh.messages import Health
from services.sensor import driver_registry
from services.sensor.rdt import RECORD, REQUEST, RdtCommand, RdtRecord
from tests.fakes.bench import CELL, DEMO
from tests.unit.common.config.test_calibration import calibration

CELLS = DEMO.parent
NETFT = load_cell(CELLS / "demo-netft.yaml")
REAL = load_cell(CELLS / "rs007l-real.yaml")
NOW = dt.datetime(2026, 11, 1, tzinfo=dt.UTC)
GOOD = RdtRecord(1, 1, 0, (0,) * 6)


def calibrated(days: int, **changes: Any) -> CellConfig:
    """Return the real cell with a calibration of this age in days."""
    found: dict[str, Any] = {
        "cell": REAL.cell,
        "made_at": NOW - dt.timedelta(days=days),
        "tool": REAL.tool.name,
        "T_flange_tcp": REAL.tool.T_flange_tcp,
        "T_flange_sensor": REAL.sensor.T_flange_sensor,
    }
    return REAL.model_copy(update={"calibration": calibration(**(found | changes))})


def using(**shares: float) -> dict[str, Health]:
    """Return the health of processes with real-time priority that use so much of a core."""
    return {
        role: Health(numbers={"processor_fraction": share}, counters={"realtime": 1})
        for role, share in shares.items()
    }


def none(cell: CellConfig) -> CellConfig:
    """Return the cell without a calibration, which accepts that."""
    payload = cell.payload.model_copy(update={"accept_uncalibrated": True})
    return cell.model_copy(update={"calibration": "none", "payload": payload})


def device(driver: str, *, exists: bool = True, has_package: bool = True) -> ReportLine:
    """Return the line of a sensor on a serial device."""
    sensor = REAL.sensor.model_copy(update={"driver": driver})
    return check_device(sensor, exists=exists, has_package=has_package)


HUB = "tcp/127.0.0.1:7447"
QUICK, LATE = [0.001, 0.0011, 0.002], [0.001, 0.0011, 0.05]
ORDINARY = {"robot": Health(numbers={"processor_fraction": 0.7})}  # without real-time priority
FAULTY = RdtRecord(1, 1, 0x80000001, (0,) * 6)
OLD = Reading(Health(version="0.0.1"), None, 0.1, "")

# The line, its result and its remedy.
# fmt: off
CASES: list[tuple[ReportLine, str, str]] = [
    (check_versions({"Python": "3.11", "numpy": "2.2"}), "PASS", ""),
    (check_versions({"Python": "3.11", "numpy": ""}), "FAIL", "versions"),
    (check_clock(QUICK, NOW), "PASS", ""),
    (check_clock(LATE, NOW), "WARN", "clock.late"),
    (check_clock(QUICK, NOW.replace(year=1970)), "WARN", "clock.calendar"),
    (check_priority(is_granted=True), "PASS", ""),
    (check_priority(is_granted=False), "WARN", "priority"),
    (check_ports({HUB: True}, is_up=False), "FAIL", "ports"),
    (check_ports({HUB: True}, is_up=True), "SKIP", ""),  # the cell itself uses it
    (check_ports({HUB: False}, is_up=False), "PASS", ""),
    (check_ports({}, is_up=False), "SKIP", ""),
    (check_calibration(REAL, NOW), "FAIL", "calibration"),
    (check_calibration(none(REAL), NOW), "WARN", "calibration"),
    (check_calibration(CELL, NOW), "PASS", ""),
    (check_calibration(calibrated(3), NOW), "PASS", ""),
    (check_calibration(calibrated(400), NOW), "WARN", "calibration.old"),
    (check_calibration(calibrated(3, tool="another"), NOW), "FAIL", "calibration"),
    (check_calibration(calibrated(3, verified=None), NOW), "FAIL", "calibration"),
    (check_role("wrench", OLD, ""), "FAIL", "role.version"),
    (sensor_line(CELL, is_up=False), "SKIP", ""),  # simulated
    (sensor_line(NETFT, is_up=True), "SKIP", ""),  # the cell uses its only stream
    (check_stream_of("there", ReceivedStream(0, None), 0.5), "FAIL", "sensor.silent"),
    (check_stream_of("there", ReceivedStream(9, FAULTY), 0.5), "FAIL", "sensor.status"),
    (check_stream_of("there", ReceivedStream(500, GOOD), 0.5), "PASS", ""),
    (device("bota"), "PASS", ""),
    (device("bota", exists=False), "FAIL", "sensor.device"),
    (device("bota", has_package=False), "FAIL", "sensor.bota"),
    (device("robotiq", exists=False, has_package=False), "FAIL", "sensor.robotiq"),
    (check_processor(using(robot=0.6, arbiter=0.7), 2, 0.95), "PASS", ""),
    (check_processor(using(robot=0.7, arbiter=0.7), 2, 0.95), "WARN", "processor"),
    (check_processor(using(robot=0.7, arbiter=0.7), 4, 0.95), "PASS", ""),
    (check_processor(using(robot=0.8), 8, 0.95), "WARN", "processor"),
    (check_processor(using(arbiter=0.7) | ORDINARY, 2, 0.95), "PASS", ""),
    (check_processor({"robot": Health()}, 2, 1.0), "PASS", ""),  # of an older version
]
# fmt: on


@pytest.mark.parametrize(("line", "word", "remedy"), CASES, ids=lambda value: str(value)[:40])
def test_each_finding_has_its_result_and_its_remedy(
    line: ReportLine, word: str, remedy: str
) -> None:
    """A line that passes or is skipped has no remedy, every other line has one."""
    assert (line.result, line.remedy) == (word, REMEDIES[remedy] if remedy else "")
    assert line.found


@pytest.mark.realtime
def test_the_sensor_is_started_and_stopped() -> None:
    """It must not continue to send to a closed port."""
    commands: list[int] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("127.0.0.1", 0))
        sensor.settimeout(20.0)

        def serve() -> None:
            for _ in range(2):
                data, peer = sensor.recvfrom(64)
                commands.append(REQUEST.unpack(data)[1])
                for number in range(20 if commands == [RdtCommand.START] else 0):
                    sensor.sendto(RECORD.pack(number, number, 0, *[0] * 6), peer)

        thread = threading.Thread(target=serve)
        thread.start()
        found = listen("127.0.0.1", sensor.getsockname()[1], 0.5)
        thread.join()
    assert (found.records, found.newest is not None) == (20, True)
    assert commands == [RdtCommand.START, RdtCommand.STOP]


PERIOD_S, DEADLINE_S = 0.004, 0.02


def line_of(
    longest_s: float, *, cause: LatencyCause = "the core", is_realtime: bool = True
) -> ReportLine:
    """Return the line on a core whose longest latency this was."""
    late_s = (*[50e-6] * 999, longest_s)
    found = CoreLatency(3, late_s, is_realtime, cause)
    return check_latency(found, period_s=PERIOD_S, deadline_s=DEADLINE_S)


@pytest.mark.parametrize(
    ("longest_s", "result"),
    [(0.0039, "PASS"), (0.0041, "WARN"), (0.0199, "WARN"), (0.0201, "FAIL")],
)
def test_a_core_is_judged_by_its_longest_latency(longest_s: float, result: str) -> None:
    """Within a control period nothing is lost; beyond a deadline the arm holds."""
    line = line_of(longest_s)
    assert (line.check, line.result) == ("latency, core 3", result)
    assert f"{1e6 * longest_s:.0f} at most" in line.found
    assert line.remedy == ("" if result == "PASS" else REMEDIES["latency"])
    assert "1000 wake-ups with SCHED_FIFO 20: 50 us late at the median" in line.found
    assert "with ordinary priority" in line_of(longest_s, is_realtime=False).found
    assert ("the core itself did not run" in line.found) == (result != "PASS")
    other = line_of(longest_s, cause="other work").found
    assert ("other work on this core" in other) == (result != "PASS")


@pytest.mark.realtime
@pytest.mark.processes
def test_each_core_is_measured_in_a_process_of_its_own() -> None:
    """One line for each core that this process may use; nearly every millisecond is measured."""
    lines = latency_lines(CELL, 0.3)
    cores = sorted(os.sched_getaffinity(0))
    assert [line.check for line in lines] == [f"latency, core {core}" for core in cores]
    assert all(1 <= int(line.found.split()[0]) <= 301 for line in lines)


def measured(duration_s: float) -> CoreLatency:
    """Measure one core in a thread of this process, which keeps its affinity and priority."""
    receiver, sender = mp.Pipe(duplex=False)
    core = min(os.sched_getaffinity(0))
    thread = threading.Thread(target=latency._measure, args=(core, duration_s, sender))
    thread.start()
    found = receiver.recv()
    thread.join()
    return found


def test_a_driver_of_another_package_is_reported_and_an_unknown_one_is_a_failure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The sensor of a driver that is not ours is not opened; the text lists what is installed."""
    cell = load_cell(CELLS / "rs007l-real.yaml", {"sensor.driver": "ftx"})
    line = sensor_line(cell, is_up=False)
    assert (line.result, line.remedy) == ("FAIL", REMEDIES["sensor.driver"])
    assert "'ftx' is not installed here, installed: bota, rdt, robotiq" in line.found
    monkeypatch.setitem(driver_registry.OURS, "ftx", "somewhere:make")
    line = sensor_line(cell, is_up=False)
    assert (line.result, line.found) == ("PASS", "ftx: installed; the sensor was not opened")


@pytest.mark.parametrize(("waited", "cause"), [(True, "other work"), (False, "the core")])
def test_the_cause_of_the_longest_latency(
    monkeypatch: pytest.MonkeyPatch, waited: bool, cause: str
) -> None:
    """The kernel counts what a thread waits for a processor; nothing waited: no other work ran."""
    for name in ("lock_memory", "take_realtime_priority", "gc.disable"):  # not of the tests
        monkeypatch.setattr(f"cli.doctor.latency.{name}", lambda: None)
    clock_ns, account_ns = [0], [0]

    def sleep(duration_s: float) -> None:
        late_ns = 30_000_000 if 40_000_000 < clock_ns[0] < 42_000_000 else 20_000
        clock_ns[0] += round(duration_s * 1e9) + late_ns
        account_ns[0] += late_ns if waited else 0

    monkeypatch.setattr("time.sleep", sleep)
    monkeypatch.setattr("time.monotonic_ns", lambda: clock_ns[0])
    monkeypatch.setattr(latency, "waited_ns", lambda: account_ns[0])
    found = measured(0.1)
    assert (max(found.late_s), found.cause) == (pytest.approx(0.03), cause)

"""Checks of `forcemesh doctor`: every result of every line, of a probe too, and every remedy."""

import re
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.doctor import checks
from cli.doctor.checks import ReportLine
from cli.doctor.probe import probe_lines
from cli.doctor.remedies import BITS, FAULTS, REMEDIES
from common.config.load import load_cell
from common.config.probe import LineCheck, ProbedGateway, ProbeFile, ProbeResult
from controller.packet_table import STATUS_SPAN, Scales, Status
from forcemesh.bus import Reading
from forcemesh.messages import Health, SensorWrench
from services.gateway.packet_window import Spread
from tests.fakes.bench import DEMO
from tests.fuzz.permissive_arbiter import READY as RUNNING
from tests.unit.cli.doctor.test_machine import CASES as MACHINE
from tools.tree import ROOT

SCALES = Scales()
LOOP = {"delay_s": 0.01, "tolerance_s": 0.007}
RATE = {"robot_hz": 40.0, "stale_after_s": 0.1}
WELL = Health(rate_hz=250.0, config_hash="this")
FRESH = Reading(WELL, None, 0.1, "")
SILENT = Reading(WELL, None, 3.0, "wrench/health stale", silent=True)
FAULTY = Reading(WELL.replaced(fault="sensor/wrench stale"), None, 0.1, "")
OTHER_FILE = Reading(WELL.replaced(config_hash="other"), None, 0.1, "")


EXTERNAL = Reading(SensorWrench(), None, 0.1, "")

EMULATED = checks.check_address("h:1", "refused", "", 0.001, is_emulated=True)

# The line, its result and its remedy.
# fmt: off
CASES: list[tuple[ReportLine, str, str]] = [
    (checks.check_address("h:1", "open", "", 0.001), "PASS", ""),
    (checks.check_address("h:1", "unresolved", "unknown", 0.1), "FAIL", "address.unresolved"),
    (checks.check_address("h:1", "refused", "", 0.001), "FAIL", "address.refused"),
    (EMULATED, "FAIL", "address.emulated"),
    (checks.check_address("h:1", "silent", "", 2.0), "FAIL", "address.silent"),
    (checks.check_address("h:1", "unreachable", "no route", 0.1), "FAIL", "address.unreachable"),
    (checks.check_hello("answered", "", 0.01), "PASS", ""),
    (checks.check_hello("silent", "", 5.0), "FAIL", "hello.silent"),
    (checks.check_hello("closed", "reset", 0.1), "FAIL", "hello.closed"),
    (checks.check_hello("garbled", "packet 1", 0.1), "FAIL", "hello.garbled"),
    (checks.check_protocol(3), "PASS", ""),
    (checks.check_protocol(1), "FAIL", "protocol"),
    (checks.check_arm(1, 1), "PASS", ""),
    (checks.check_arm(2, 1), "FAIL", "arm"),
    (checks.check_peer(any_peer=False), "PASS", ""),
    (checks.check_peer(any_peer=True), "WARN", "peer"),
    (checks.check_peer(any_peer=None), "WARN", "error.none"),
    (checks.check_scales(SCALES, SCALES.vec), "PASS", ""),
    (checks.check_scales(SCALES, (60, 500, 250, 100, 1000, 10)), "FAIL", "scales"),
    (checks.check_sender(40.0, 0.03, **RATE), "PASS", ""),
    (checks.check_sender(35.0, 0.03, **RATE), "WARN", "sender.slow"),
    (checks.check_sender(9.0, 0.12, **RATE), "FAIL", "sender.stale"),
    (checks.check_sender(40.0, 0.2, **RATE), "WARN", "sender.gap"),
    (checks.check_sender(None, None, **RATE), "FAIL", "reports.none"),
    (checks.check_error_code(0), "PASS", ""),
    (checks.check_error_code(None), "WARN", "error.none"),
    (checks.check_error_code(-34024), "FAIL", "error.as"),
    (checks.check_error_code(99), "WARN", "error.unknown"),
    (checks.check_loops(2.0), "PASS", ""),
    (checks.check_loops(0.0), "FAIL", "loops.stand"),
    (checks.check_loops(None), "WARN", "loops.unknown"),
    (checks.check_monitor_speed(1.0), "PASS", ""),
    (checks.check_monitor_speed(0.1), "WARN", "monitor speed.slow"),
    (checks.check_monitor_speed(0.0), "FAIL", "monitor speed.zero"),
    (checks.check_monitor_speed(None), "WARN", "error.none"),
    (checks.check_monitor_speed(0.48, 50.0), "FAIL", "monitor speed.lower"),
    (checks.check_monitor_speed(0.495, 50.0), "PASS", ""),
    (checks.check_monitor_speed(0.505, 50.0), "PASS", ""),
    (checks.check_monitor_speed(0.52, 50.0), "WARN", "monitor speed.higher"),
    (checks.check_round_trip(Spread(0.01, 0.03), 0.25), "PASS", ""),
    (checks.check_round_trip(Spread(0.01, 0.13), 0.25), "WARN", "round trip.long"),
    (checks.check_round_trip(None, 0.25), "FAIL", "round trip.none"),
    (checks.check_loop_delay(0.040, 0.034, **LOOP), "PASS", ""),
    (checks.check_loop_delay(0.042, 0.034, **LOOP), "WARN", "loop delay"),
    (checks.check_loop_delay(0.026, 0.034, **LOOP), "WARN", "loop delay"),
    (checks.check_plain()[-1], "WARN", "plain"),
    (checks.check_goodbye(held=True), "PASS", ""),
    (checks.check_goodbye(held=False), "WARN", "goodbye"),
    (checks.check_role("wrench", FRESH, "this"), "PASS", ""),
    (checks.check_role("sensor", EXTERNAL, "this"), "PASS", ""),
    (checks.check_role("wrench", SILENT, "this"), "FAIL", "role.silent"),
    (checks.check_role("wrench", FAULTY, "this"), "FAIL", "role.fault"),
    (checks.check_role("wrench", OTHER_FILE, "this"), "WARN", "role.config"),
    (checks.check_serial("FT1"), "PASS", ""),
    (checks.check_serial(""), "WARN", "sensor serial"),
    (checks.check_stream("wrench", 250.0, 250.0), "PASS", ""),
    (checks.check_stream("wrench", 200.0, 250.0), "WARN", "stream.slow"),
    (checks.check_stream("wrench", 200.0, 250.0, slow_below=0.6), "PASS", ""),
    (checks.check_stream("wrench", None, 250.0), "FAIL", "stream.silent"),
]
# fmt: on
# Of report.py, verb.py and latency.py.
ELSEWHERE = {"cell file", "bus", "bus.down", "link", "reports.broken", "latency", "sensor.driver"}


@pytest.mark.parametrize(("line", "word", "remedy"), CASES, ids=lambda value: str(value)[:40])
def test_each_finding_has_its_result_and_its_remedy(
    line: ReportLine, word: str, remedy: str
) -> None:
    """A line that passes has no remedy, every other line has one."""
    assert line.result == word
    assert line.remedy == (REMEDIES[remedy] if remedy else "")
    assert line.found


def test_every_remedy_is_reached() -> None:
    """Every listed remedy is given by some check, here or in the tables of the other modules."""
    tabled = {remedy for _, _, remedy in (*CASES, *MACHINE) if remedy}
    elsewhere = {key for key in REMEDIES if key.startswith(("pose.", "probe."))}
    assert tabled | elsewhere | ELSEWHERE == set(REMEDIES)
    assert all(REMEDIES.values())


@given(st.integers(0, STATUS_SPAN - 1))
def test_every_bit_is_checked_in_every_status(bits: int) -> None:
    """There is one line for each bit; bits that prevent motion fail."""
    lines = checks.check_status(Status(bits))
    assert len({line.check for line in lines}) == len(lines) == len(Status)
    failed = {row.bit for row in BITS for line in lines if line.check == row.check
              and line.result == "FAIL"}  # fmt: skip
    forbidden = Status.WATCHDOG_LATCHED | Status.ERROR
    assert failed == set((RUNNING & ~Status(bits)) | (forbidden & Status(bits)))


def test_fault_codes_are_those_of_the_program() -> None:
    """Each code of controller/README.md has its line."""
    text = (ROOT / "controller" / "README.md").read_text(encoding="utf-8")
    listed = {
        int(code) for code in re.findall(r"^\| (\d+) \|", text.split("## Faults")[1], re.MULTILINE)
    }
    assert listed == set(FAULTS)
    for code, (text, result, remedy) in FAULTS.items():
        line = checks.check_error_code(code)
        assert (line.result, line.remedy) == (result, remedy)
        assert line.found == f"{code}: {text}"


TCP = load_cell(DEMO.with_name("demo-tcp.yaml"))
MEASURED = datetime(2026, 6, 1, tzinfo=UTC)
PROBE = ProbeFile(measured_at=MEASURED, controller="F60", stages=("a", "b", "c"))
HERE, SWITCHES = "127.0.0.1:49152", ("abs.speed", "qtool", "errstart.pc", "slow_start")
DIFFERS = {"a": LineCheck(expected="1", found="2", same=False)}


def number(name: str, value: float | None) -> dict[str, Any]:
    """Return the change to one result, measured or not."""
    return {"results": {name: ProbeResult(value=value, why="" if value is not None else "x")}}


def segment(least_s: float | None) -> dict[str, Any]:
    """Return the change to another least segment."""
    return {"gateway": ProbedGateway(least_segment_s=least_s)}


PROBED: list[tuple[dict[str, Any], str, str | None]] = [
    ({}, "probe", "PASS"),
    ({"measured_at": (MEASURED - timedelta(days=364)).replace(tzinfo=None)}, "probe", "PASS"),
    ({"measured_at": MEASURED - timedelta(days=366)}, "probe", "WARN"),
    ({"measured_at": None}, "probe", "WARN"),
    ({"stages": ("a", "b")}, "probe", "WARN"),
    *((number(f"switch.{name}", -1.0), name.upper(), "WARN") for name in SWITCHES),
    (number("switch.qtool", 0.0), "QTOOL", "PASS"),
    (number("switch.qtool", None), "QTOOL", None),
    (number("task.2", 1.0), "PC programs", "WARN"),
    (number("task.5", 1.0), "PC programs", None),  # 4 and 5 are free for others
    (number("behaviour.tcp_error_stands", 1.0), "TCP errors", "WARN"),
    (number("behaviour.tcp_error_stands", 0.0), "TCP errors", None),
    ({}, "probe address", None),
    ({"address": HERE}, "probe address", "PASS"),
    ({"address": "192.168.0.2:49152"}, "probe address", "WARN"),
    ({"lines": DIFFERS}, "AS lines", "FAIL"),
    (segment(None), "least segment", "PASS"),
    (segment(0.02), "least segment", "PASS"),  # set points come every 25 ms
    (segment(0.03), "least segment", "WARN"),
]


@pytest.mark.parametrize(("changes", "check", "result"), PROBED)
def test_each_finding_of_a_probe_has_its_row(
    changes: dict[str, Any], check: str, result: str | None
) -> None:
    """A date without a zone is UTC; what could not be read has no row."""
    lines = probe_lines(TCP, PROBE.model_copy(update=changes), now=MEASURED)
    found = {line.check: line.result for line in lines}
    assert found.get(check) == result


def test_every_remedy_of_a_probe_is_reached() -> None:
    """By the rows above."""
    probes = [PROBE.model_copy(update=changes) for changes, _, _ in PROBED]
    remedies = {line.remedy for probe in probes for line in probe_lines(TCP, probe, now=MEASURED)}
    assert remedies - {""} == {REMEDIES[key] for key in REMEDIES if key.startswith("probe.")}

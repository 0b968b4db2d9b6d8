"""Rows of the doctor that the probe of a controller gives."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from cli.doctor.probe import probe_lines
from cli.doctor.remedies import REMEDIES
from common.config.load import load_cell
from common.config.probe import LineCheck, ProbedGateway, ProbeFile, ProbeResult
from tests.fakes.bench import DEMO

CELL = load_cell(DEMO.with_name("demo-tcp.yaml"))
NOW = datetime(2026, 6, 1, tzinfo=UTC)
GOOD = ProbeFile(measured_at=NOW, controller="F60", stages=("a", "b", "c"))
HERE, SWITCHES = "127.0.0.1:49152", ("abs.speed", "qtool", "errstart.pc", "slow_start")
DIFFERS = {"a": LineCheck(expected="1", found="2", same=False)}


def number(name: str, value: float | None) -> dict[str, Any]:
    """Return the change to one result, measured or not."""
    return {"results": {name: ProbeResult(value=value, why="" if value is not None else "x")}}


def segment(least_s: float | None) -> dict[str, Any]:
    """Return the change to another least segment."""
    return {"gateway": ProbedGateway(least_segment_s=least_s)}


CASES: list[tuple[dict[str, Any], str, str | None]] = [
    ({}, "probe", "PASS"),
    ({"measured_at": (NOW - timedelta(days=364)).replace(tzinfo=None)}, "probe", "PASS"),
    ({"measured_at": NOW - timedelta(days=366)}, "probe", "WARN"),
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


@pytest.mark.parametrize(("changes", "check", "result"), CASES)
def test_each_finding_has_its_row(changes: dict[str, Any], check: str, result: str | None) -> None:
    """A date without a zone is UTC; what could not be read has no row."""
    lines = probe_lines(CELL, GOOD.model_copy(update=changes), now=NOW)
    found = {line.check: line.result for line in lines}
    assert found.get(check) == result


def test_every_remedy_of_a_probe_is_reached() -> None:
    """By the rows above."""
    probes = [GOOD.model_copy(update=changes) for changes, _, _ in CASES]
    remedies = {line.remedy for probe in probes for line in probe_lines(CELL, probe, now=NOW)}
    assert remedies - {""} == {REMEDIES[key] for key in REMEDIES if key.startswith("probe.")}

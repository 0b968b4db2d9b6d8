"""Rows of the doctor that the probe of a controller gives."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from cli.doctor.probe import probe_lines
from cli.doctor.remedies import REMEDIES
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.config.probe import LineCheck, ProbedGateway, ProbeFile, ProbeResult
from tools.tree import ROOT

NOW = datetime(2026, 6, 1, tzinfo=UTC)
GOOD = ProbeFile(measured_at=NOW, controller="F60", stages=("a", "b", "c"))


def cell(**changes: Any) -> CellConfig:
    """Return a cell with a controller."""
    return load_cell(ROOT / "cells" / "demo-tcp.yaml", {k.replace("__", "."): v
                                                       for k, v in changes.items()})  # fmt: skip


def results(probe: ProbeFile, of: CellConfig | None = None) -> dict[str, str]:
    """Return the result of each row."""
    return {line.check: line.result for line in probe_lines(of or cell(), probe, now=NOW)}


def with_numbers(**numbers: float | None) -> ProbeFile:
    """Return a probe with these results; a double underscore stands for a dot."""
    named = {name.replace("__", "."): ProbeResult(value=value, why="" if value is not None else "x")
             for name, value in numbers.items()}  # fmt: skip
    return GOOD.model_copy(update={"results": named})


@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ({}, "PASS"),
        ({"measured_at": (NOW - timedelta(days=364)).replace(tzinfo=None)}, "PASS"),
        ({"measured_at": NOW - timedelta(days=366)}, "WARN"),
        ({"measured_at": None}, "WARN"),
        ({"stages": ("a", "b")}, "WARN"),
        ({"stages": (), "controller": ""}, "WARN"),
    ],
)
def test_a_probe_ages_and_has_all_stages(changes: dict[str, Any], result: str) -> None:
    """A date without a zone is UTC."""
    assert results(GOOD.model_copy(update=changes))["probe"] == result


@pytest.mark.parametrize("name", ["abs.speed", "qtool", "errstart.pc", "slow_start"])
@pytest.mark.parametrize(("state", "result"), [(-1.0, "WARN"), (0.0, "PASS"), (None, None)])
def test_a_switch_that_surprises_is_a_warning(
    name: str, state: float | None, result: str | None
) -> None:
    """One that could not be read has no row."""
    probe = with_numbers(**{f"switch.{name}": state})
    assert results(probe).get(name.upper()) == result


def test_pc_programs_in_use_and_standing_errors_are_warnings() -> None:
    """4 and 5 are free for others."""
    assert "PC programs" not in results(with_numbers(task__1=0.0, task__5=1.0))
    assert results(with_numbers(task__2=1.0))["PC programs"] == "WARN"
    assert results(with_numbers(behaviour__tcp_error_stands=1.0))["TCP errors"] == "WARN"
    assert "TCP errors" not in results(with_numbers(behaviour__tcp_error_stands=0.0))


def test_a_probe_of_another_address_is_a_warning() -> None:
    """It may be that of another controller."""
    assert "probe address" not in results(GOOD)
    here = GOOD.model_copy(update={"address": "127.0.0.1:49152"})
    assert results(here)["probe address"] == "PASS"
    assert results(here, cell(gateway__host="192.168.0.2"))["probe address"] == "WARN"


@pytest.mark.parametrize(
    ("least_s", "robot_hz", "result"),
    [(0.03, 30.0, "PASS"), (0.03, 60.0, "WARN"), (None, 60.0, "PASS")],
)
def test_set_points_faster_than_the_least_segment_are_a_warning(
    least_s: float | None, robot_hz: float, result: str
) -> None:
    """33 ms are enough for 30 ms, 17 ms are not."""
    probe = GOOD.model_copy(update={"gateway": ProbedGateway(least_segment_s=least_s)})
    assert results(probe, cell(rates__robot_hz=robot_hz))["least segment"] == result


def test_every_remedy_of_a_probe_is_reached() -> None:
    """By a probe with every flaw, and by a good one that is old."""
    switches = {f"switch.{name}": -1.0
                for name in ("abs.speed", "qtool", "errstart.pc", "slow_start")}  # fmt: skip
    flawed = with_numbers(**switches, task__1=1.0, behaviour__tcp_error_stands=1.0).model_copy(
        update={
            "stages": ("a", "b"),
            "address": "192.168.0.9:49152",
            "lines": {"a": LineCheck(expected="1", found="2", same=False)},
            "gateway": ProbedGateway(least_segment_s=0.4),
        }
    )
    old = GOOD.model_copy(update={"measured_at": None})
    lines = [line for probe in (flawed, old) for line in probe_lines(cell(), probe, now=NOW)]
    (differs,) = (line for line in lines if line.check == "AS lines")
    assert (differs.result, differs.found.rpartition(": ")[2]) == ("FAIL", "a")
    assert {line.remedy for line in lines} - {""} == {
        REMEDIES[key] for key in REMEDIES if key.startswith("probe.")
    }

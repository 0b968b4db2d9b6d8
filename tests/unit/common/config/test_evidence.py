"""Evidence of a bring-up: states of its steps, hashes of their inputs, the measured speed."""

from datetime import UTC, datetime
from pathlib import Path

import pytest
import yaml

from common.config.evidence import (
    BringupEvidence,
    StepEvidence,
    evidence_file,
    input_hashes,
    ladder,
    measured_monitor_speed,
    read_evidence,
    save_evidence,
)

NOW = datetime(2026, 11, 27, 8, 0, tzinfo=UTC)
TREE = {
    "gateway": {"host": "a", "port": 1},
    "robot": {"probe": "probe.yaml", "delay_s": 0.1},
    "calibration": "made.yaml",
}
PROBE = "robot: {delay_s: 0.1}\nresults: {mspeed: {value: 10.0, unit: '%'}}\n"


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    """A cell file with a probe in its folder."""
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(TREE))
    (tmp_path / "probe.yaml").write_text(PROBE)
    return path


def passed(cell_file: Path, *names: str, **numbers: float) -> StepEvidence:
    """Return a step that passes now."""
    return StepEvidence(passed_at=NOW, inputs=input_hashes(cell_file, names), numbers=numbers)


def test_what_is_written_is_read(cell_file: Path) -> None:
    """In the real cell file's folder, in the order of the steps; without a file nothing passed."""
    link = cell_file.with_name("link.yaml")
    link.symlink_to(cell_file)
    assert read_evidence(cell_file) == BringupEvidence()
    steps = {"b": passed(cell_file, "gateway", delay_s=0.1), "a": StepEvidence()}
    save_evidence(cell_file, BringupEvidence(steps=steps))
    assert evidence_file(cell_file) == cell_file.with_name("lab.bringup.yaml")
    found = read_evidence(link)
    assert found == BringupEvidence(steps=steps)
    assert list(found.steps) == ["b", "a"]


@pytest.mark.parametrize(
    ("change", "changed"),
    [
        ({"gateway": {"host": "b", "port": 1}}, "gateway.host"),
        ({"gateway": {"port": 1}}, "gateway.host"),
        ({"robot": {"probe": "probe.yaml", "delay_s": 0.2}}, ""),
    ],
)
def test_a_step_is_changed_when_its_part_of_the_cell_file_is(
    cell_file: Path, change: dict[str, object], changed: str
) -> None:
    """And by no other part; a step that has failed since it passed is failed."""
    step = passed(cell_file, "gateway.host", "probe")
    failed = step.model_copy(update={"failed_at": NOW, "why": "off"})
    steps = {"one": step, "failed": failed, "open": StepEvidence()}
    evidence = BringupEvidence(steps=steps)
    assert ladder(cell_file, evidence)[0].state == "passed"
    cell_file.write_text(yaml.safe_dump(TREE | change))
    row, *others = ladder(cell_file, evidence)
    assert row.state == ("changed" if changed else "passed")
    assert row.detail.startswith(changed)
    assert [(each.state, each.detail) for each in others] == [("failed", "off"), ("open", "")]


def test_the_delay_holds_for_the_monitor_speed_of_the_file_that_it_is_from(
    cell_file: Path,
) -> None:
    """The tuning replaces the probe; without either it is not known."""
    assert measured_monitor_speed(cell_file) == 10.0
    (cell_file.parent / "tuning.yaml").write_text("robot: {delay_s: 0.2}\n")
    tune = passed(cell_file, "tuning", monitor_speed_percent=25.0)
    save_evidence(cell_file, BringupEvidence(steps={"tune": tune}))
    assert measured_monitor_speed(cell_file) == 10.0
    cell_file.write_text(yaml.safe_dump(TREE | {"tuning": "tuning.yaml"}))
    assert measured_monitor_speed(cell_file) == 25.0
    failed = StepEvidence(failed_at=NOW, why="stopped", numbers={"monitor_speed_percent": 5.0})
    save_evidence(cell_file, BringupEvidence(steps={"tune": failed}))
    assert measured_monitor_speed(cell_file) is None
    save_evidence(cell_file, BringupEvidence(steps={"tune": tune}))
    (cell_file.parent / "tuning.yaml").write_text("robot: {delay_s: 0.3}\n")
    assert measured_monitor_speed(cell_file) is None
    evidence_file(cell_file).unlink()
    assert measured_monitor_speed(cell_file) is None

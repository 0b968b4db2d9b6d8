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
    named_files,
    read_evidence,
    save_evidence,
)
from forcemesh.errors import ConfigError, DataError

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


def test_a_step_is_changed_when_one_of_its_files_is(cell_file: Path) -> None:
    """Written, changed, and removed; what is not there has a hash too."""
    files = ("probe", "calibration", "tuning")
    hashes = [input_hashes(cell_file, files)]
    for name in files:
        named_files(cell_file)[name].write_text("x: 1\n")
        hashes.append(input_hashes(cell_file, files))
        assert [part for part in files if hashes[-1][part] != hashes[-2][part]] == [name]


def test_a_file_that_cannot_be_read_is_one_message(
    cell_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The panel shows it; it must not end with it."""

    def refuse(_: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(ConfigError, match=r"probe\.yaml: cannot be read: Permission denied"):
        input_hashes(cell_file, ["gateway", "probe"])


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


def test_without_a_probe_the_monitor_speed_of_the_delay_is_not_known(cell_file: Path) -> None:
    """Nor with a probe whose delay is null."""
    (cell_file.parent / "probe.yaml").write_text("results: {mspeed: {value: 10.0}}\n")
    assert measured_monitor_speed(cell_file) is None
    for robot in ({"delay_s": 0.1}, None):
        cell_file.write_text(yaml.safe_dump({"robot": robot}))
        assert measured_monitor_speed(cell_file) is None


def test_a_wrong_file_is_one_message(cell_file: Path) -> None:
    """A cell file that is a list; an evidence file with an unknown name; one that is a folder."""
    evidence_file(cell_file).write_text("bringup: 1\nsteppes: {}\n")
    with pytest.raises(ConfigError, match="did you mean steps"):
        read_evidence(cell_file)
    evidence_file(cell_file).unlink()
    evidence_file(cell_file).mkdir()
    with pytest.raises(DataError, match="cannot be written"):
        save_evidence(cell_file, BringupEvidence())
    cell_file.write_text("[1]\n")
    with pytest.raises(ConfigError, match="map of sections"):
        input_hashes(cell_file, ["gateway"])
    cell_file.unlink()
    with pytest.raises(ConfigError, match="no such file"):
        ladder(cell_file, BringupEvidence())

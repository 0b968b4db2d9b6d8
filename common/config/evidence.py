"""Evidence of a bring-up: which step of the ladder has passed when, and with which files.

`forcemesh bringup` writes it into the folder of the cell file as `<cell file>.bringup.yaml`; doctor
and panel read it. A step is no longer passed when a part of the cell file or a file that it depends
on has changed: the evidence has a hash of each.
"""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from common.config.load import CALIBRATION, PROBE, TUNING, named_file, value_at
from common.config.probe import ProbeFile
from common.config.state_file import replace_file
from forcemesh.connection import ConfigSection
from forcemesh.errors import ConfigError
from forcemesh.yaml_file import read_model, read_yaml

PROGRAMS = Path(__file__).resolve().parents[2] / "controller"
PROBE_NAME, TUNING_NAME = "probe.yaml", "tuning.yaml"  # where the cell file names none
TUNE_STEP, MONITOR_SPEED = "tune", "monitor_speed_percent"
HASH_CHARS = 12
HEAD = """\
# Written by `forcemesh bringup`, see docs/connect-your-kawasaki.md: what has passed when, with
# hashes of what it depends on. A step whose inputs have changed is no longer passed.
"""

StepState = Literal["passed", "changed", "failed", "open"]


class StepEvidence(ConfigSection):
    """Last attempt of one step. Numbers have their unit in the name; inputs are hashes."""

    passed_at: datetime | None = None
    failed_at: datetime | None = None
    why: str = ""  # it failed
    inputs: dict[str, str] = Field({})
    numbers: dict[str, float] = Field({})


class BringupEvidence(ConfigSection):
    """Content of the evidence file: every step of the ladder in its order."""

    bringup: Literal[1] = 1  # version of the file
    steps: dict[str, StepEvidence] = Field({})


@dataclass(frozen=True, slots=True)
class LadderRow:
    """One step as it is shown: its state, and the time or the reason."""

    name: str
    state: StepState
    detail: str = ""


def evidence_file(cell_file: Path) -> Path:
    """Return the path of a cell's evidence: in the folder of the real cell file."""
    real = cell_file.resolve()
    return real.with_name(f"{real.stem}.bringup.yaml")


def read_evidence(cell_file: Path) -> BringupEvidence:
    """Return the evidence of a cell, empty without a file. Raises ConfigError for a wrong one."""
    path = evidence_file(cell_file)
    if not path.exists():
        return BringupEvidence()
    return read_model(BringupEvidence, path)


def save_evidence(cell_file: Path, evidence: BringupEvidence) -> None:
    """Write the evidence of a cell. Raises DataError."""
    path = evidence_file(cell_file)
    tree = evidence.model_dump(mode="json", exclude_defaults=True) | {"bringup": evidence.bringup}
    replace_file(path, HEAD + yaml.safe_dump(tree, sort_keys=False, width=100))


def ladder(cell_file: Path, evidence: BringupEvidence) -> list[LadderRow]:
    """Return every step with its present state. Raises ConfigError for a wrong cell file."""
    _tree(cell_file)  # also where no step has passed
    return [row_of(cell_file, name, step) for name, step in evidence.steps.items()]


def row_of(cell_file: Path, name: str, step: StepEvidence) -> LadderRow:
    """Return the present state of one step."""
    if step.failed_at is not None:
        return LadderRow(name, "failed", step.why)
    if step.passed_at is None:
        return LadderRow(name, "open")
    now, at = input_hashes(cell_file, step.inputs), f"{step.passed_at:%Y-%m-%d %H:%M} UTC"
    changed = [part for part, found in step.inputs.items() if now[part] != found]
    if changed:
        return LadderRow(name, "changed", f"{', '.join(changed)} changed since {at}")
    return LadderRow(name, "passed", at)


# --- inputs ---------------------------------------------------------------------------------------


def input_hashes(cell_file: Path, names: Iterable[str]) -> dict[str, str]:
    """Return a hash of each input as it is now.

    Args:
        cell_file: The cell file.
        names: Files (`probe`, `calibration`, `tuning`, `fmprobe.as`, `forcemesh.as`), or sections
            and fields of the cell file (`gateway`, `gateway.port`). What is not there has a hash
            too.

    Raises:
        ConfigError: The cell file or one of the files cannot be read.
    """
    tree, files = _tree(cell_file), named_files(cell_file)
    hashes = {}
    for name in names:
        if name in files:
            data = _content(files[name])
            if name == "calibration":  # a later check of the axes does not change it
                data = data.partition(b"\naxes:")[0]
        else:
            data = json.dumps(value_at(tree, name), sort_keys=True, default=str).encode()
        hashes[name] = hashlib.sha256(data).hexdigest()[:HASH_CHARS]
    return hashes


def named_files(cell_file: Path) -> dict[str, Path]:
    """Return the files that a step may depend on; probe and tuning have a default in its folder.

    Raises ConfigError when the cell file cannot be read.
    """
    folder, calibration = cell_file.resolve().parent, named_file(cell_file, CALIBRATION)
    return {
        "probe": named_file(cell_file, PROBE) or folder / PROBE_NAME,
        "tuning": named_file(cell_file, TUNING) or folder / TUNING_NAME,
        **({} if calibration is None else {"calibration": calibration}),
        **{name: PROGRAMS / name for name in ("fmprobe.as", "forcemesh.as")},
    }


def measured_monitor_speed(cell_file: Path) -> float | None:
    """Return the monitor speed [%] at which the cell's `robot.delay_s` was measured, if recorded.

    With a file `tuning` it is that of the step that wrote this file, else that of the probe.
    Raises ConfigError.
    """
    if named_file(cell_file, TUNING) is not None:
        step = read_evidence(cell_file).steps.get(TUNE_STEP, StepEvidence())
        is_of_this_file = step.inputs.get("tuning") == input_hashes(cell_file, ["tuning"])["tuning"]
        return step.numbers.get(MONITOR_SPEED) if is_of_this_file else None
    file = named_file(cell_file, PROBE)
    if file is None or (probe := read_model(ProbeFile, file)).robot.delay_s is None:
        return None
    return probe.number("mspeed")


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes() if file.is_file() else b""
    except OSError as error:
        raise ConfigError(str(file), [f"cannot be read: {error.strerror}"]) from error


def _tree(cell_file: Path) -> dict[str, Any]:
    tree = read_yaml(cell_file.resolve(), str(cell_file))
    if not isinstance(tree, dict):
        raise ConfigError(str(cell_file), ["the file must hold a map of sections"])
    return tree

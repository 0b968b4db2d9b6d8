"""Loader of cell files, with the files that they name and the keys of older versions."""

import hashlib
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from common.config.calibration import NO_FILE, CalibrationSection
from common.config.cell import CellConfig
from common.config.probe import ProbeFile
from forcemesh.errors import ConfigError
from forcemesh.yaml_file import Model, read_model, read_yaml, validated

CALIBRATION, PROBE, TUNING = "calibration", "robot.probe", "tuning"  # keys of files

TUNED = (  # fields permitted in the file that a cell file names as `tuning`
    "robot.delay_s",
    "robot.lag_s",
    "robot.bandwidth_rad_s",
    "contact.stiffness_N_m",
    "contact.tilt_stiffness_Nm_rad",
    "force.approach_m_s",
)

RENAMED = {  # keys of older cell files, still read
    "force.given_J": "force.environment_work_J",
    "gateway.max_untaken_setpoints": "gateway.max_unexecuted_setpoints",
}


def load_cell(
    path: Path | str, overrides: dict[str, Any] | None = None, *, with_files: bool = True
) -> CellConfig:
    """Read a cell file.

    Args:
        path: The YAML file, or a link to it: files that it names are next to the real file.
        overrides: Values that replace the file's, by dotted path ("sim.tilt_deg").
        with_files: Take the files that it names. Without, they may be missing or wrong, for a verb
            that writes one of them.

    Raises:
        ConfigError: The file cannot be read or holds mistakes; all of them are listed.
    """
    path = _followed(Path(path))
    source = str(path)
    tree = read_yaml(path, source)
    if isinstance(tree, dict):
        if not with_files:
            _drop_files(tree)
        _take_probe(tree, path)
        _take_tuning(tree, path, source)
        for dotted, value in (overrides or {}).items():
            _set(tree, dotted, value, source)
        if (file := _named(tree, path, CALIBRATION)) is not None:
            remedy = "move the file away, start the cell and calibrate"
            tree[CALIBRATION] = None
            if file.exists():
                tree[CALIBRATION] = _read_file(CalibrationSection, file.resolve(), remedy)
    return cell_from_tree(tree, source)


def named_file(cell_file: Path, key: str) -> Path | None:
    """Return the path that a cell file names by a key, relative to its folder; None without one.

    Args:
        cell_file: The cell file, or a link to it.
        key: Key of a file, by its dotted path: CALIBRATION, PROBE or TUNING.

    Raises:
        ConfigError: The cell file cannot be read.
    """
    path = _followed(cell_file)
    return _named(read_yaml(path, str(path)), path, key)


def value_at(tree: Any, dotted: str) -> Any:
    """Return the value at a dotted path of a parsed file, None where there is none."""
    for part in dotted.split("."):
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


def _named(tree: Any, path: Path, key: str) -> Path | None:
    name = value_at(tree, key)
    return path.parent / name if isinstance(name, str) and name != NO_FILE else None


def _followed(path: Path) -> Path:
    return path.resolve() if path.is_symlink() else path


def _drop_files(tree: dict[str, Any]) -> None:
    for key in (CALIBRATION, PROBE, TUNING):
        *section, name = key.split(".")
        values = value_at(tree, section[0]) if section else tree
        if isinstance(values, dict) and values.get(name) != NO_FILE:
            values.pop(name, None)


def _take_probe(tree: dict[str, Any], path: Path) -> None:
    """Override values of the cell file with those measured by `forcemesh probe`.

    Its delay is that of a motion alone, without the line and the loop of the program: it replaces
    a shorter one only. The whole loop is measured by `forcemesh tune`.
    """
    file = _named(tree, path, PROBE)
    if file is None:
        return
    remedy = f"measure it with `forcemesh probe`, or take {PROBE} out of the cell file"
    probe = _read_file(ProbeFile, file, remedy)
    del tree["robot"]["probe"]
    for name, measured in (("robot", probe.robot), ("gateway", probe.gateway)):
        if isinstance(tree.get(name), dict):
            before = tree[name].get("delay_s")
            tree[name] |= measured.model_dump(exclude_none=True)
            delays_s = [each for each in (before, tree[name].get("delay_s")) if _is_number(each)]
            if delays_s:
                tree[name]["delay_s"] = max(delays_s)


def _read_file(model: type[Model], file: Path, remedy: str) -> Model:
    """Return the content of a file that a cell file names; its last mistake has the remedy."""
    try:
        return read_model(model, file)
    except ConfigError as error:
        *mistakes, last = error.mistakes
        raise ConfigError(error.source, [*mistakes, f"{last}; {remedy}"]) from error


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _take_tuning(tree: dict[str, Any], path: Path, source: str) -> None:
    """Override values of the cell file with those measured by `forcemesh tune`."""
    file = _named(tree, path, TUNING)
    if file is None:
        return
    del tree[TUNING]
    measured = read_yaml(file, str(file))
    sections = measured.values() if isinstance(measured, dict) else [None]
    if not all(isinstance(section, dict) for section in sections):
        raise ConfigError(str(file), ["it must hold sections of `forcemesh tune` values"])
    for section, values in measured.items():
        for name, value in values.items():
            dotted = f"{section}.{name}"
            if dotted not in TUNED:
                mistake = f"{dotted}: not a tuning field, valid: {', '.join(TUNED)}"
                raise ConfigError(str(file), [mistake])
            _set(tree, dotted, value, source)


def cell_from_tree(tree: object, source: str) -> CellConfig:
    """Validate an already parsed cell file. Raise ConfigError as `load_cell` does."""
    if isinstance(tree, dict):
        for old, new in RENAMED.items():
            _take_renamed(tree, old, new, source)
        found = tree.get(CALIBRATION)
        if isinstance(found, dict):  # of a dump
            try:
                tree = {**tree, CALIBRATION: validated(CalibrationSection, found, source)}
            except ConfigError as error:
                mistakes = [f"{CALIBRATION}.{what}" for what in error.mistakes]
                raise ConfigError(source, mistakes) from None
        elif found not in (None, NO_FILE) and not isinstance(found, CalibrationSection):
            mistake = f"{CALIBRATION}: must be a path or `{NO_FILE}`, found {found!r}"
            raise ConfigError(source, [mistake])
    return validated(CellConfig, tree, source)


def _take_renamed(tree: dict[str, Any], old: str, new: str, source: str) -> None:
    """Move the value of an old key to the new one."""
    section, old_key = old.split(".")
    values, new_key = tree.get(section), new.split(".")[1]
    if not isinstance(values, dict) or old_key not in values:
        return
    if new_key in values:
        raise ConfigError(source, [f"{old}: the old name of {new}, which is set as well"])
    # A copy: the caller's tree stays as it was read.
    tree[section] = {new_key if key == old_key else key: each for key, each in values.items()}
    _warn(source, f"{old} is now {new}: rename it")


@lru_cache
def _warn(source: str, text: str) -> None:
    """Write a warning once."""
    sys.stderr.write(f"{source}: {text}\n")


def cell_hash(cell: CellConfig) -> str:
    """Return a short hash of the effective configuration: equal in every process of a cell.

    The calibration is excluded: one process uses it, reports its revision, and may load another.
    The sections panel and recorder are excluded too: no control loop reads them.
    """
    text = cell.model_dump_json(exclude={"calibration", "panel", "recorder"})
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def dump_cell(cell: CellConfig) -> str:
    """Return a cell file that loads into the same cell."""
    text: str = yaml.safe_dump(cell.model_dump(mode="json", exclude_none=True), sort_keys=False)
    return text


def _set(tree: Any, dotted: str, value: object, source: str) -> None:
    keys = dotted.split(".")
    for depth, key in enumerate(keys[:-1], start=1):
        tree[key] = {} if tree.get(key) is None else tree[key]
        tree = tree[key]
        if not isinstance(tree, dict):
            mistake = f"{dotted}: {'.'.join(keys[:depth])} is not a section"
            raise ConfigError(source, [mistake])
    tree[keys[-1]] = value

"""Cell files: every mistake at once, each with its path, its cure, and nothing half read."""

from pathlib import Path
from typing import Any, get_origin

import pytest
import yaml
from pydantic import BaseModel

from common.config.cell import CellConfig
from common.config.load import (
    PROBE,
    RENAMED,
    TUNED,
    cell_from_tree,
    cell_hash,
    dump_cell,
    load_cell,
    named_file,
)
from forcemesh.errors import ConfigError

ROOT = Path(__file__).resolve().parents[4]
CELLS = sorted((ROOT / "cells").glob("*.yaml"))
DEMO = ROOT / "cells" / "demo.yaml"
DEMO_CELL = load_cell(DEMO)
OLD_VALUES = {"force.given_J": 0.0625, "gateway.max_untaken_setpoints": 2}  # not the defaults
VALID = ", ".join(TUNED)

each_cell = pytest.mark.parametrize("path", CELLS, ids=lambda path: path.stem)


def tree() -> dict[str, Any]:
    """Return the demo cell as parsed YAML, to be damaged."""
    parsed: dict[str, Any] = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
    del parsed["calibration"]  # names a file, which this tree has no folder for
    return parsed


def mistakes(damaged: object) -> list[str]:
    """Return the mistakes of a parsed cell file."""
    with pytest.raises(ConfigError) as caught:
        cell_from_tree(damaged, "x.yaml")
    return caught.value.mistakes


def sections(model: type[BaseModel] = CellConfig, path: str = "") -> dict[str, type[BaseModel]]:
    """Return every section of a cell file by its path; of a list or a map of them one."""
    found: dict[str, type[BaseModel]] = {}
    for field, info in model.model_fields.items():
        origin = get_origin(info.annotation)
        name = field + (".0" if origin is tuple else ".any" if origin is dict else "")
        for kind in (info.annotation, *getattr(info.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found[f"{path}{name}"] = kind
                found |= sections(kind, f"{path}{name}.")
    return found


# --- files that ship ------------------------------------------------------------------------------


@each_cell
def test_a_cell_that_is_dumped_loads_into_the_same_cell(path: Path, tmp_path: Path) -> None:
    """Every value, of every file that ships."""
    cell, copy = load_cell(path), tmp_path / "copy.yaml"
    copy.write_text(dump_cell(cell), encoding="utf-8")
    assert load_cell(copy) == cell


# --- mistakes -------------------------------------------------------------------------------------


def test_all_mistakes_are_reported_at_once_each_with_its_path() -> None:
    """Wrong range, wrong type, missing, unknown, wrong word, wrong length: one line each."""
    damaged = tree()
    damaged["rates"]["robot_hz"] = 0
    damaged["sim"]["delay_s"] = "soon"
    del damaged["payload"]["mass_kg"]
    damaged["limits"]["sped_m_s"] = 0.1
    damaged["roles"]["robot"] = "simulated"
    damaged["robot"]["joint_min_deg"] = [1, 2, 3]
    damaged["tool"]["T_flange_tcp"]["position_m"] = [0, 0, float("nan")]
    with pytest.raises(ConfigError, match=r"^x\.yaml: 7 mistakes\n  - ") as caught:
        cell_from_tree(damaged, "x.yaml")
    starts = {
        "rates.robot_hz: must be at least 5 Hz, found 0 Hz",
        "sim.delay_s: must be a number, found 'soon'",
        "payload.mass_kg: missing",
        "limits.sped_m_s: unknown name; did you mean speed_m_s?",
        "roles.robot: must be 'sim', 'gateway' or 'external', found 'simulated'",
        "robot.joint_min_deg: must hold at least 6 values, found [1, 2, 3]",
        "tool.T_flange_tcp.position_m.2: must be a finite number, found nan",
    }
    for start in starts:
        assert f"\n  - {start}" in str(caught.value), start


@pytest.mark.parametrize("section", ["", *sections()])
def test_an_unknown_name_is_reported_in_every_section(section: str) -> None:
    """Swept: near to a valid name that name is offered, else all of them are listed."""
    model = sections()[section] if section else CellConfig
    name = next(iter(model.model_fields))
    for wrong, hint in ((f"{name}x", f"did you mean {name}?"), ("qqqqqqqq", "valid names: ")):
        damaged = tree()
        inner = damaged
        for key in section.removesuffix(".0").split(".") if section else ():
            if not isinstance(inner.get(key), dict):
                inner[key] = {}
            outer, inner = inner, inner[key]
            if section.endswith(f".{key}.0"):
                outer[key] = [inner]
        inner[wrong] = 1
        line = f"{section}.{wrong}".lstrip(".") + f": unknown name; {hint}"
        assert [found for found in mistakes(damaged) if found.startswith(line)], mistakes(damaged)


# --- files ----------------------------------------------------------------------------------------


def test_a_missing_file_is_reported_with_its_neighbours(tmp_path: Path) -> None:
    """Most often it is a slip of the pen; a folder is no file either."""
    (tmp_path / "right.yaml").write_text("cell: x", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"no such file; there are .*right\.yaml"):
        load_cell(tmp_path / "wrong.yaml")
    with pytest.raises(ConfigError, match="no such file"):
        load_cell(tmp_path / "no folder" / "wrong.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_cell(tmp_path)


@pytest.mark.parametrize("overrides", [None, {"sim.tilt_deg": 5.0}])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"cell: [1, 2", "not YAML: "),
        (b"cell: x\n\tbus: 1", "not YAML: "),
        (b"cell: !!python/object:os.system x", "not YAML: "),
        (b"cell: \xff\xfe", "cannot be read: "),
        (b"", "the file must hold a map of sections"),
        (b"- 1", "the file must hold a map of sections"),
        (b"cell: x\nsim: &s {sim: *s}", "sim.sim: unknown name"),
        (b"&c {cell: *c}", "cell: "),
        (b"sim:", "cell: missing"),
        (b"[" * 5000 + b"]" * 5000, "not a cell file: lists or sections too deep"),
    ],
)
def test_a_file_that_is_no_cell_file_is_one_clear_error(
    tmp_path: Path, content: bytes, message: str, overrides: dict[str, Any] | None
) -> None:
    """Broken YAML, other bytes, nothing at all, a section inside itself."""
    path = tmp_path / "cell.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_cell(path, overrides)
    assert [line for line in caught.value.mistakes if message in line], caught.value.mistakes


def test_repeated_names_are_all_reported_with_their_lines(tmp_path: Path) -> None:
    """YAML would silently take the last one: the limit that a person reads is not the one kept."""
    path = tmp_path / "cell.yaml"
    path.write_text("cell: x\nlimits:\n  force_N: 20\n  force_N: 60\ncell: y\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_cell(path)
    assert caught.value.mistakes == [
        "limits.force_N: defined twice, in lines 3 and 4",
        "cell: defined twice, in lines 1 and 5",
    ]


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("sim.tilt_dg", "sim.tilt_dg: unknown name; did you mean tilt_deg?"),
        ("cell.name", "cell.name: cell is not a section"),
    ],
)
def test_an_override_is_judged_like_the_file(path: str, message: str) -> None:
    """A wrong name, a wrong value, a path through something that is no section."""
    with pytest.raises(ConfigError) as caught:
        load_cell(DEMO, {path: "wrong"})
    assert [line for line in caught.value.mistakes if line.startswith(message)], str(caught.value)


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_old_key_is_read_with_one_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str
) -> None:
    """A newly written file has the new key; both keys together are a mistake."""
    path, file = tmp_path / "cell.yaml", tree()
    (section, old_key), new_key = old.split("."), new.split(".")[1]
    file.setdefault(section, {})[old_key] = value = OLD_VALUES[old]
    path.write_text(yaml.safe_dump(file), encoding="utf-8")
    cell = load_cell(path)
    assert load_cell(path) == cell
    assert getattr(getattr(cell, section), new_key) == value
    assert capsys.readouterr().err == f"{path}: {old} is now {new}: rename it\n"
    assert old_key not in dump_cell(cell)
    file[section][new_key] = value
    path.write_text(yaml.safe_dump(file), encoding="utf-8")
    with pytest.raises(ConfigError, match=f"{old}: the old name of {new}, which is set as well"):
        load_cell(path)


# --- hash -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n, s in DEMO_CELL if isinstance(s, BaseModel)])
def test_every_number_changes_the_hash_but_those_of_processes_that_only_watch(name: str) -> None:
    """Panel and recorder move nothing: their settings do not prevent arming."""
    section = getattr(DEMO_CELL, name)
    for field, value in section:
        if isinstance(value, float):
            other = section.model_copy(update={field: 1.0001 * value if value else 1e-6})
            changed = cell_hash(DEMO_CELL.model_copy(update={name: other}))
            assert (changed != cell_hash(DEMO_CELL)) == (name not in {"panel", "recorder"}), field


# --- files that a cell file names -----------------------------------------------------------------


def cell_file(folder: Path, **named: str) -> Path:
    """Write the demo's cell file, and each file that it names: its key and its content."""
    file, path = tree(), folder / "cell.yaml"
    for key, content in named.items():
        (folder / f"{key}.yaml").write_text(content, encoding="utf-8")
        section = file["robot"] if key == "probe" else file
        section[key] = f"{key}.yaml"
    path.write_text(yaml.safe_dump(file), encoding="utf-8")
    return path


def test_a_cell_takes_what_the_probe_of_its_controller_measured(tmp_path: Path) -> None:
    """Null stays as the file has it; a dumped cell has the values and needs no probe."""
    path = cell_file(
        tmp_path,
        probe="robot: {delay_s: 0.021, lag_s: null, motions_ahead: 3}\n"
        "gateway: {least_segment_s: 0.027, least_speed_m_s: null}\n",
    )
    assert load_cell(path).gateway is None
    path.write_text(path.read_text() + "gateway: {least_speed_m_s: 0.002}\n", encoding="utf-8")
    cell = load_cell(path)
    robot = (cell.robot.delay_s, cell.robot.lag_s, cell.robot.motions_ahead)
    assert robot == (0.021, DEMO_CELL.robot.lag_s, 3)
    assert cell.gateway is not None
    assert (cell.gateway.least_segment_s, cell.gateway.least_speed_m_s) == (0.027, 0.002)
    path.write_text(dump_cell(cell), encoding="utf-8")
    assert load_cell(path) == cell
    assert named_file(path, PROBE) is None


@pytest.mark.parametrize(("before_s", "loaded_s"), [(0.01, 0.021), (0.1, 0.1), (True, 0.021)])
def test_the_delay_of_a_probe_replaces_a_shorter_one_only(
    tmp_path: Path, before_s: object, loaded_s: float
) -> None:
    """It is that of a motion alone, and a loop with too short a delay is unstable."""
    path = cell_file(tmp_path, probe="robot: {delay_s: 0.021}")
    file = yaml.safe_load(path.read_text())
    file["robot"]["delay_s"] = before_s
    path.write_text(yaml.safe_dump(file))
    assert load_cell(path).robot.delay_s == loaded_s


@pytest.mark.parametrize("path", TUNED)
def test_a_tuned_value_replaces_a_typed_one_and_that_of_the_probe(
    path: str, tmp_path: Path
) -> None:
    """Each of the fields that `forcemesh tune` measures, of the whole loop; no other changes."""
    section, name = path.split(".")
    value = 0.75 * float(getattr(getattr(DEMO_CELL, section), name))
    file = cell_file(
        tmp_path, tuning=f"{section}: {{{name}: {value!r}}}", probe="robot: {delay_s: 0.3}"
    )
    before = DEMO_CELL.model_dump()
    before[section][name] = value
    before["calibration"] = None
    if path != "robot.delay_s":
        before["robot"]["delay_s"] = 0.3
    assert load_cell(file).model_dump() == before


REMEDY = "measure it with `forcemesh probe`, or take robot.probe out of the cell file"


@pytest.mark.parametrize(
    ("key", "content", "mistake"),
    [
        (
            "probe",
            "robot: {delay: 1}",
            f"robot.delay: unknown name; did you mean delay_s?; {REMEDY}",
        ),
        ("probe", "[]", f"the file must hold a map of sections; {REMEDY}"),
        ("tuning", "limits: {force_N: 1.0}", f"limits.force_N: not a tuning field, valid: {VALID}"),
        ("tuning", "robot: {delay: 1.0}", f"robot.delay: not a tuning field, valid: {VALID}"),
        *(
            ("tuning", text, "it must hold sections of `forcemesh tune` values")
            for text in ("", "[robot, contact]", "robot: 3", "robot:")
        ),
    ],
)
def test_a_mistake_in_a_named_file_is_reported_as_one_of_that_file(
    tmp_path: Path, key: str, content: str, mistake: str
) -> None:
    """A tuning changes no limit, which a person sets; without its files the cell file is read."""
    path = cell_file(tmp_path, **{key: content})
    with pytest.raises(ConfigError) as caught:
        load_cell(path)
    assert caught.value.source == str(tmp_path / f"{key}.yaml")
    assert caught.value.mistakes == [mistake]
    assert load_cell(path, with_files=False).robot == DEMO_CELL.robot

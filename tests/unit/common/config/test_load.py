"""Cell files: every mistake at once, each with its path, its cure, and nothing half read."""

from pathlib import Path
from typing import Any, get_origin

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from common.config.cell import CellConfig
from common.config.load import (
    CALIBRATION,
    PROBE,
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
def test_every_cell_file_that_ships_loads(path: Path) -> None:
    """The name inside is fit for a key, and the limits are fit to start with."""
    cell = load_cell(path)

    assert cell.cell
    assert load_cell(str(path)) == cell


@each_cell
def test_a_cell_that_is_dumped_loads_into_the_same_cell(path: Path, tmp_path: Path) -> None:
    """Every value, and so the hash; also a second time."""
    cell, copy = load_cell(path), tmp_path / "copy.yaml"
    copy.write_text(dump_cell(cell), encoding="utf-8")

    assert load_cell(copy) == cell
    assert cell_hash(load_cell(copy)) == cell_hash(cell)
    assert dump_cell(load_cell(copy)) == dump_cell(cell)


@given(st.floats(250.0, 1e6), st.floats(-1.0, 1.0))
def test_any_number_survives_the_dump(stiffness: float, x_m: float) -> None:
    """The last digit too: YAML reads 1e-05 as text, so it must not be written like that."""
    contact = DEMO_CELL.contact.model_copy(update={"stiffness_N_m": stiffness})
    payload = DEMO_CELL.payload.model_copy(update={"com_m": (x_m, 1e-17, -0.0)})
    cell = DEMO_CELL.model_copy(update={"contact": contact, "payload": payload})

    assert cell_from_tree(yaml.safe_load(dump_cell(cell)), "x") == cell


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
    found = mistakes(damaged)

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
        assert [line for line in found if line.startswith(start)], (start, found)


def test_the_error_names_the_file_and_counts() -> None:
    """As a person reads it."""
    with pytest.raises(ConfigError) as caught:
        cell_from_tree({"cell": "x", "nonsense": 1}, "cells/mine.yaml")

    text = str(caught.value)
    assert text.startswith(f"cells/mine.yaml: {len(caught.value.mistakes)} mistakes\n  - ")
    assert all(f"  - {mistake}" in text for mistake in caught.value.mistakes)
    assert str(ConfigError("cells/mine.yaml", ["no such file"])) == "cells/mine.yaml: no such file"


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"roles": {"robot": "gateway", "sensor": "driver"}}, "a section `gateway` is needed"),
        ({"sim": None}, "a section `sim` is needed"),
        ({"cell": "Demo Cell"}, "cell: must be"),
        ({"bus": {"endpoint": "localhost"}}, "bus.endpoint: must be"),
    ],
)
def test_sections_that_do_not_go_together_are_reported(
    changes: dict[str, Any], message: str
) -> None:
    """In words about the file, not about the program."""
    (line,) = mistakes(tree() | changes)
    assert message in line


@pytest.mark.parametrize(
    ("section", "key", "value_mm"),
    [
        ("limits", "workspace_max_m", [400, 800, 600]),
        ("limits", "workspace_min_m", [-400, -800, 0]),
    ],
)
def test_millimetres_instead_of_metres_are_reported(section: str, key: str, value_mm: Any) -> None:
    """No arm is that large: not taken for a workspace without an end."""
    damaged = tree()
    damaged[section][key] = value_mm
    (mistake,) = mistakes(damaged)
    assert mistake.startswith(section)
    assert mistake.endswith("is that in millimetres?")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_empty_workspace_is_reported_with_its_axis(axis: int) -> None:
    """Lower and upper exchanged by mistake: the arm could go nowhere."""
    damaged = tree()
    limits = damaged["limits"]
    limits["workspace_max_m"][axis] = limits["workspace_min_m"][axis]
    (line,) = mistakes(damaged)
    assert line.startswith("limits: workspace is empty along " + "xyz"[axis])


@pytest.mark.parametrize("nothing", [None, [], "text", 3, [1, 2]])
def test_a_file_that_holds_no_sections_is_reported(nothing: object) -> None:
    """An empty file, a list, a word."""
    assert mistakes(nothing) == ["the file must hold a map of sections"]


@pytest.mark.parametrize("key", [1, 2.5, True, None])
def test_a_key_that_is_no_name_is_a_mistake(key: object) -> None:
    """YAML allows numbers as keys; a cell file does not, also inside a section."""
    inside: dict[Any, Any] = {**tree()["sim"], key: 1}
    assert mistakes({**tree(), "sim": inside})
    outside: dict[Any, Any] = tree()
    outside[key] = 1
    assert mistakes(outside)


# --- files ----------------------------------------------------------------------------------------


def test_a_missing_file_is_reported_with_its_neighbours(tmp_path: Path) -> None:
    """Most often it is a slip of the pen."""
    (tmp_path / "right.yaml").write_text("cell: x", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"no such file; there are .*right\.yaml"):
        load_cell(tmp_path / "wrong.yaml")
    with pytest.raises(ConfigError, match="no such file"):
        load_cell(tmp_path / "no folder" / "wrong.yaml")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"cell: [1, 2", "not YAML: "),
        (b"cell: x\n\tbus: 1", "not YAML: "),
        (b"cell: !!python/object:os.system x", "not YAML: "),
        (b"cell: \xff\xfe", "cannot be read: "),
        (b"", "the file must hold a map of sections"),
        (b"cell: x\nsim: &s {sim: *s}", "sim.sim: unknown name"),
        (b"&c {cell: *c}", "cell: "),
    ],
)
def test_a_file_that_is_no_cell_file_is_one_clear_error(
    tmp_path: Path, content: bytes, message: str
) -> None:
    """Broken YAML, other bytes, nothing at all, a section inside itself."""
    path = tmp_path / "cell.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_cell(path)
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


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    """Reported like any other file that cannot be read."""
    with pytest.raises(ConfigError, match="cannot be read"):
        load_cell(tmp_path)


# --- overrides ------------------------------------------------------------------------------------


def test_overrides_replace_and_add_by_dotted_path() -> None:
    """Also where the file has no such section yet; the file itself is not touched."""
    cell = load_cell(DEMO, {"sim.tilt_deg": 5.0, "force.touch_N": 1.0, "filter.median": 5})

    assert cell.sim is not None
    assert (cell.sim.tilt_deg, cell.force.touch_N, cell.filter.median) == (5.0, 1.0, 5)
    assert load_cell(DEMO) == DEMO_CELL


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("sim.tilt_dg", "sim.tilt_dg: unknown name; did you mean tilt_deg?"),
        ("simm.tilt_deg", "simm: unknown name; did you mean sim?"),
        ("sim.tilt_deg", "sim.tilt_deg: must be a number"),
        ("cell.name", "cell.name: cell is not a section"),
        ("rates.robot_hz.x", "rates.robot_hz.x: rates.robot_hz is not a section"),
    ],
)
def test_an_override_is_judged_like_the_file(path: str, message: str) -> None:
    """A wrong name, a wrong value, a path through something that is no section."""
    with pytest.raises(ConfigError) as caught:
        load_cell(DEMO, {path: "wrong"})
    assert [line for line in caught.value.mistakes if line.startswith(message)], str(caught.value)


@pytest.mark.parametrize("content", ["", "- 1", "sim:", "sim: 3"])
def test_an_override_of_a_file_that_is_none_is_a_clear_error(tmp_path: Path, content: str) -> None:
    """Empty, a list, a section without content."""
    path = tmp_path / "cell.yaml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError):
        load_cell(path, {"sim.tilt_deg": 5.0})


# --- hash -----------------------------------------------------------------------------------------


def test_the_hash_is_of_the_values_not_of_the_words(tmp_path: Path) -> None:
    """Comments, order and defaults written out do not matter; it is short and stable."""
    shuffled = dict(reversed(tree().items()))
    shuffled["filter"] = {"lowpass_s": 5e-3, "median": 3}

    assert cell_hash(cell_from_tree(shuffled, "x")) == cell_hash(DEMO_CELL)
    assert len(cell_hash(DEMO_CELL)) == 12


def numbers(data: Any, path: str = "") -> list[str]:
    """Return the dotted path of every number outside of lists."""
    if isinstance(data, dict):
        inner = [numbers(value, f"{path}.{key}".lstrip(".")) for key, value in data.items()]
        return [leaf for leaves in inner for leaf in leaves]
    return [path] if isinstance(data, float) else []


@pytest.mark.parametrize("path", numbers(DEMO_CELL.model_dump(mode="json", exclude={"recorder"})))
def test_every_number_changes_the_hash(path: str) -> None:
    """Swept: two processes that differ in any value are not of one cell."""
    section, _, name = path.rpartition(".")
    value = getattr(getattr(DEMO_CELL, section), name)
    other = load_cell(DEMO, {path: value * 1.0001 if value else 1e-6})

    assert cell_hash(other) != cell_hash(DEMO_CELL)


@pytest.mark.parametrize(("path", "value"), [("recorder.keep_min", 7.0), ("panel.port", 5555)])
def test_processes_that_only_watch_may_be_set_up_otherwise(path: str, value: float) -> None:
    """Panel and recorder move nothing: their settings do not prevent arming."""
    assert cell_hash(load_cell(DEMO, {path: value})) == cell_hash(DEMO_CELL)


def test_a_named_file_is_in_the_folder_of_the_cell_file_and_not_of_a_link(tmp_path: Path) -> None:
    """Calibration and tuning are found through a link as they are without it."""
    file, link = tmp_path / "mine.yaml", tmp_path / "elsewhere" / "cell.yaml"
    file.write_text(DEMO.read_text("utf-8") + "tuning: tuned.yaml\n", "utf-8")
    (tmp_path / "tuned.yaml").write_text("robot: {delay_s: 0.033}\n", "utf-8")
    link.parent.mkdir()
    link.symlink_to(file)

    assert load_cell(link).robot.delay_s == 0.033
    assert named_file(link, CALIBRATION) == named_file(file, CALIBRATION)


# --- probe ----------------------------------------------------------------------------------------


def with_probe(folder: Path, text: str, **robot: Any) -> Path:
    """Write a probe, and the demo's cell file that names it; return the cell file."""
    (folder / "probe.yaml").write_text(text, encoding="utf-8")
    named = tree()
    named["robot"] |= {"probe": "probe.yaml"} | robot
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(named), encoding="utf-8")
    return path


def test_a_cell_takes_what_the_probe_of_its_controller_measured(tmp_path: Path) -> None:
    """Null stays as the file has it; a dumped cell has the values and needs no probe."""
    text = (
        "robot: {delay_s: 0.021, lag_s: null, motions_ahead: 3}\n"
        "gateway: {least_segment_s: 0.027, least_speed_m_s: null}\n"
    )
    path = with_probe(tmp_path, text, lag_s=0.033, delay_s=0.001)
    assert load_cell(path).gateway is None
    path.write_text(path.read_text() + "gateway: {least_speed_m_s: 0.002}\n", encoding="utf-8")
    robot, gateway = load_cell(path).robot, load_cell(path).gateway
    assert (robot.delay_s, robot.lag_s, robot.motions_ahead) == (0.021, 0.033, 3)
    assert gateway is not None
    assert (gateway.least_segment_s, gateway.least_speed_m_s) == (0.027, 0.002)
    assert named_file(path, PROBE) == tmp_path / "probe.yaml"
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump_cell(load_cell(path)), encoding="utf-8")
    assert load_cell(copy) == load_cell(path)
    assert named_file(copy, PROBE) is None


@pytest.mark.parametrize(("before_s", "loaded_s"), [(0.01, 0.021), (0.1, 0.1), (True, 0.021)])
def test_the_delay_of_a_probe_replaces_a_shorter_one_only(
    tmp_path: Path, before_s: object, loaded_s: float
) -> None:
    """It is that of a motion alone, and a loop with too short a delay is unstable."""
    path = with_probe(tmp_path, "robot: {delay_s: 0.021}\n", delay_s=before_s)
    assert load_cell(path).robot.delay_s == loaded_s


def test_tuning_is_measured_later_than_the_probe_and_wins(tmp_path: Path) -> None:
    """It measured the whole loop."""
    path = with_probe(tmp_path, "robot: {delay_s: 0.021}\n")
    (tmp_path / "tuning.yaml").write_text("robot: {delay_s: 0.05}\n", encoding="utf-8")
    path.write_text(path.read_text() + "tuning: tuning.yaml\n", encoding="utf-8")
    assert load_cell(path).robot.delay_s == 0.05


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot: {delay: 1}\n", "robot.delay: unknown name; did you mean delay_s?"),
        ("robot: {delay_s: soon}\n", "robot.delay_s: must be a number"),
        ("probe: 2\n", "probe: "),
        ("[]\n", "must hold a map of sections"),
    ],
)
def test_a_mistake_in_a_probe_names_its_file(tmp_path: Path, text: str, words: str) -> None:
    """As those of a cell file."""
    with pytest.raises(ConfigError) as refused:
        load_cell(with_probe(tmp_path, text))
    assert words in str(refused.value)
    assert "probe.yaml" in str(refused.value)


def test_a_cell_file_that_holds_nothing_has_no_probe(tmp_path: Path) -> None:
    """Nor has one whose section robot is no section."""
    path = tmp_path / "cell.yaml"
    for text in ("[]\n", "robot: 1\n", "cell: x\n"):
        path.write_text(text, encoding="utf-8")
        assert named_file(path, PROBE) is None

"""Numbers in another unit: refused in each field of cell, payload and calibration."""

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from common.config.calibration import CalibrationSection
from common.config.cell import SETPOINT_SHARE, USUAL_FORCE_N, USUAL_SPEED_M_S
from common.config.load import cell_from_tree, dump_cell, load_cell
from common.config.payload import Payload, load, save
from forcemesh.errors import ConfigError, DataError
from forcemesh.units import UNITS, question, unit_of
from tests.unit.common.config.test_calibration import calibration

CELLS = sorted((Path(__file__).parents[3] / "cells").glob("*.yaml"))
DEMO = next(path for path in CELLS if path.stem == "demo")
# A residual is a result, judged by force.idle_max_*; a drift's clock may begin anywhere.
RESULTS = ("fit", "verified", "start_s", "end_s")
PAYLOAD = Payload(
    mass_kg=1.2,
    com_m=(0.01, -0.02, 0.06),
    bias_force_N=(1.4, -2.1, 3.1),
    bias_torque_Nm=(0.3, -0.4, 0.2),
    mounting_rotation_rad=(0.1, 0, 0),
)


def whole(path: Path) -> dict[str, Any]:
    """Return a cell file with every default written out."""
    tree: dict[str, Any] = yaml.safe_load(dump_cell(load_cell(path)))
    return tree


def physical(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every number, or list of numbers, that has a unit and is not zero."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for name, value in items:
        if isinstance(value, dict) or (isinstance(value, list) and value and value[0] is dict):
            yield from physical(value, (*path, name))
        elif unit_of(str(name)) and not isinstance(value, str | bool) and np.any(value):
            yield (*path, name)


def scaled(tree: dict[str, Any], path: tuple[Any, ...], factor: float) -> dict[str, Any]:
    """Return a tree with one of its fields in another unit."""
    copy = deepcopy(tree)
    inside: Any = copy
    for name in path[:-1]:
        inside = inside[name]
    value = inside[path[-1]]
    is_whole = isinstance(value, int) and factor >= 1.0
    inside[path[-1]] = (
        [factor * v for v in value]
        if isinstance(value, list)
        else int(factor * value)
        if is_whole
        else factor * value
    )
    return copy


def mistake(tree: dict[str, Any]) -> str:
    """Return the mistake of a cell file, empty when there is none."""
    try:
        cell_from_tree(tree, "x.yaml")
    except ConfigError as error:
        return "\n".join(error.mistakes)
    return ""


@pytest.mark.parametrize("path", CELLS, ids=lambda path: path.stem)
def test_each_physical_field_times_a_thousand_is_refused_with_the_question(path: Path) -> None:
    """Swept over all shipped cells and all defaults: millimetres, milliseconds, grams, ..."""
    tree = whole(path)
    assert mistake(tree) == ""
    unread = {
        "counts_per": tree["roles"]["sensor"] != "driver",
        "plain.": (tree.get("gateway") or {}).get("protocol") != "plain",
    }  # no process reads them elsewhere
    fields = [
        field
        for field in physical(tree)
        if not any(name in ".".join(field) and is_unread for name, is_unread in unread.items())
    ]
    assert len(fields) > 60
    taken = {
        ".".join(field): message
        for field in fields
        if "is that in" not in (message := mistake(scaled(tree, field, 1000.0)))
    }
    assert taken == {}


@pytest.mark.parametrize(
    ("field", "factor", "asks"),
    [
        (("contact", "stiffness_N_m"), 1e-3, "newtons per millimetre"),
        (("robot", "joint_max_deg"), 0.0, ""),
        (("robot", "joint_speed_max_deg_s"), np.pi / 180.0, "radians a second"),
        (("rates", "control_hz"), 1e-3, "kilohertz"),
        (("force", "speed_max_rad_s"), 180.0 / np.pi, "degrees a second"),
        (("sensor", "torque_range_Nm"), 1000.0, "newton millimetres"),
        (("gateway", "watchdog_s"), 1000.0, "milliseconds"),
    ],
)
def test_other_usual_units_are_asked_for(field: tuple[str, ...], factor: float, asks: str) -> None:
    """Also where the number comes out too small."""
    tree = whole(DEMO.with_name("demo-tcp.yaml"))
    if asks:
        assert f"is that in {asks}?" in mistake(scaled(tree, field, factor))
        return
    turned = scaled(tree, field, np.pi / 180.0)
    turned = scaled(turned, ("robot", "joint_min_deg"), np.pi / 180.0)
    assert "is that in radians?" in mistake(turned)


def test_a_number_that_fits_no_other_unit_is_not_asked_about() -> None:
    """A negative mass is no matter of units."""
    tree = whole(DEMO)
    tree["payload"]["mass_kg"] = -1.0
    assert mistake(tree) == "payload.mass_kg: must be at least 0 kg, found -1 kg"
    assert question("delay_s", 1e9, 0.5) == ""
    assert question("nothing", 1e9, 0.5) == ""


@pytest.mark.parametrize("ending", UNITS)
def test_the_longest_ending_decides_the_unit(ending: str) -> None:
    """speed_max_m_s is m/s, not s."""
    assert unit_of(f"x{ending}") is UNITS[ending]


# --- payload and calibration files ----------------------------------------------------------------


def test_each_field_of_a_payload_file_times_a_thousand_is_refused(tmp_path: Path) -> None:
    """With the file, the key and the question."""
    path = tmp_path / "p.yaml"
    save(PAYLOAD, path)
    assert load(path) == PAYLOAD
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    for field in physical(tree):
        path.write_text(yaml.safe_dump(scaled(tree, field, 1000.0)), encoding="utf-8")
        with pytest.raises(DataError, match=rf"p\.yaml: {field[0]}.*is that in"):
            load(path)


def test_each_field_of_a_calibration_times_a_thousand_is_refused() -> None:
    """As where it is by hand in the cell file: the same section."""
    drift = {"start_s": 0.0, "end_s": 9.0, "force_N": [2.0] * 3, "torque_Nm": [0.2] * 3}
    made = calibration().model_dump(mode="json") | {"revision": ""}
    made["payload"] |= {
        "bias_force_N": [1.4, -2.1, 3.1],
        "bias_torque_Nm": [0.3, -0.4, 0.2],
        "mounting_rotation_rad": [0.1, 0.0, 0.0],
        "drift": drift,
    }
    CalibrationSection(**made)
    tree = {**whole(DEMO), "calibration": made}
    assert mistake(tree) == ""
    for field in physical(made):
        if not set(field) & set(RESULTS):
            found = mistake(scaled(tree, ("calibration", *field), 1000.0))
            assert "is that in" in found, field


def test_a_direction_of_gravity_is_a_direction() -> None:
    """(0, 0, -2) would double the weight of every tool."""
    tree = whole(DEMO)
    tree["gravity_direction_in_base"] = [0.0, 0.0, -2.0]
    assert "the direction has length 2, it must be 1" in mistake(tree)


# --- ceilings -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "usual"), [("force_N", USUAL_FORCE_N), ("speed_m_s", USUAL_SPEED_M_S)]
)
def test_more_than_usual_names_the_risk_assessment(name: str, usual: float) -> None:
    """At the bound nothing is asked; above it a text, not blanks; the sentence names the remedy."""
    tree = whole(DEMO)
    limits = tree["limits"]
    limits |= {"force_N": USUAL_FORCE_N, "speed_m_s": USUAL_SPEED_M_S, "risk_assessment": ""}
    tree["force"]["setpoint_max_N"] = 10.0
    assert mistake(tree) == ""
    limits[name] = 1.01 * usual
    for text in ("", "  "):
        limits["risk_assessment"] = text
        assert f"{name} is {1.01 * usual:g}" in mistake(tree)
        assert "name the risk assessment of this cell in limits.risk_assessment" in mistake(tree)
    limits["risk_assessment"] = "RA-17, 2026-11-23, A. Person"
    assert mistake(tree) == ""


def test_the_largest_set_point_stays_below_the_ceiling() -> None:
    """At 0.7 of it there is room for an overshoot; above, the press would stop itself."""
    tree = whole(DEMO)
    most_N = SETPOINT_SHARE * tree["limits"]["force_N"]
    tree["force"]["setpoint_max_N"] = most_N
    assert mistake(tree) == ""
    tree["force"]["setpoint_max_N"] = most_N + 0.1
    assert "at most 42 N is allowed (0.7 of limits.force_N, 60 N)" in mistake(tree)


def test_every_question_names_a_unit() -> None:
    """`is that in thousandths of that?` is no question."""
    names = [wrong.name for unit in UNITS.values() for wrong in unit.wrongs]
    assert not [name for name in names if name.split()[-1] in {"that", "this", "it"}]

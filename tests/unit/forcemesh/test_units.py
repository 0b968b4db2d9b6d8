"""Numbers in another unit: refused in each field of cell, payload and calibration."""

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from common.config.load import cell_from_tree, dump_cell, load_cell
from forcemesh.errors import ConfigError
from forcemesh.units import UNITS, question, unit_of

CELLS = sorted((Path(__file__).parents[3] / "cells").glob("*.yaml"))
DEMO = next(path for path in CELLS if path.stem == "demo")


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


def test_a_number_that_is_too_small_is_asked_about_and_one_that_fits_no_unit_is_not() -> None:
    """A negative mass is no matter of units."""
    tree = whole(DEMO)
    soft = mistake(scaled(tree, ("contact", "stiffness_N_m"), 1e-3))
    assert "is that in newtons per millimetre?" in soft
    tree["payload"]["mass_kg"] = -1.0
    assert mistake(tree) == "payload.mass_kg: must be at least 0 kg, found -1 kg"
    assert question("delay_s", 1e9, 0.5) == ""
    assert question("nothing", 1e9, 0.5) == ""


@pytest.mark.parametrize("ending", UNITS)
def test_the_longest_ending_decides_the_unit(ending: str) -> None:
    """speed_max_m_s is m/s, not s."""
    assert unit_of(f"x{ending}") is UNITS[ending]


def test_every_question_names_a_unit() -> None:
    """`is that in thousandths of that?` is no question."""
    names = [wrong.name for unit in UNITS.values() for wrong in unit.wrongs]
    assert not [name for name in names if name.split()[-1] in {"that", "this", "it"}]

"""The forecast map: fits to measured jobs of force control, read from force_map.json. Pure.

Each law has one fit for each quantity: the logarithm of measured value over model value, as a
polynomial of second degree in normalised features of a job,

    ln(value / model) = sum_i c_i z_i + sum_ij c_ij z_i z_j,    z_0 = 1

with its width w from cross-validation: value exp(-w) .. value exp(w) contained the stated share of
the measured jobs that a fit had not seen. `python -m bench.forecast.fit` measures it.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement
from math import exp
from pathlib import Path
from typing import Any

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError

FILE = Path(__file__).with_name("force_map.json")
REMEDY = "make it again: python -m bench.forecast.fit"


@dataclass(frozen=True, slots=True)
class Interval:
    """Range of a value."""

    low: float
    high: float

    def contains(self, value: float) -> bool:
        """Return whether a value is within."""
        return self.low <= value <= self.high


@dataclass(frozen=True, slots=True)
class QuantityFit:
    """Fit of one quantity of one law."""

    features: tuple[str, ...]
    centre: tuple[float, ...]
    scale: tuple[float, ...]
    coefficients: tuple[float, ...]
    width: float  # half of the interval, as a logarithm

    def interval(self, model: float, features: Mapping[str, float]) -> Interval:
        """Return the interval of the quantity.

        Args:
            model: Value of the model, in the unit of the quantity.
            features: Features of the job by name.
        """
        row = np.array([[features[name] for name in self.features]])
        z = (row - np.array(self.centre)) / np.array(self.scale)
        value = model * exp(float(terms(z)[0] @ np.array(self.coefficients)))
        return Interval(value * exp(-self.width), value * exp(self.width))


@dataclass(frozen=True, slots=True)
class LawMap:
    """Map of one law: measured range of each coordinate, and fit of each quantity."""

    ranges: Mapping[str, Interval]
    fits: Mapping[str, QuantityFit]


def terms(z: Array) -> Array:
    """Return the terms of the polynomial. Shape (jobs, features) to (jobs, terms)."""
    columns = [np.ones(len(z)), *z.T]
    pairs = combinations_with_replacement(range(z.shape[1]), 2)
    columns += [z[:, first] * z[:, second] for first, second in pairs]
    return np.array(columns).T


def check_value(tree: Mapping[str, Any]) -> str:
    """Return the check value of a map's tree, without its own."""
    kept = {key: value for key, value in tree.items() if key != "check"}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode("utf-8")).hexdigest()[:12]


@cache
def force_map(path: Path = FILE) -> dict[str, LawMap]:
    """Read the map of each law.

    Raises:
        DataError: The file is missing, or was changed by hand.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {error}: {REMEDY}") from None
    if not isinstance(tree, dict) or tree.get("check") != check_value(tree):
        raise DataError(f"{path}: was changed by hand: {REMEDY}")
    return {law: _law_map(each) for law, each in tree["laws"].items()}


def _law_map(tree: Mapping[str, Any]) -> LawMap:
    return LawMap(
        {name: Interval(low, high) for name, (low, high) in tree["ranges"].items()},
        {name: _fit(each) for name, each in tree["fits"].items()},
    )


def _fit(tree: Mapping[str, Any]) -> QuantityFit:
    def numbers(name: str) -> Sequence[Any]:
        return tuple(tree[name])

    return QuantityFit(
        tuple(map(str, numbers("features"))),
        tuple(numbers("centre")),
        tuple(numbers("scale")),
        tuple(numbers("coefficients")),
        float(tree["width"]),
    )

"""What hangs below the force/torque sensor, what it makes the sensor read, and its YAML file."""

import difflib
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from common.errors import DataError
from common.frames import GRAVITY_M_S2, Array, rotation_from_vector

Vector = tuple[float, float, float]

DOWN: Vector = (0.0, 0.0, -1.0)
UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Payload:
    """Weight and bias in sensor axes, seen from the sensor origin.

    The last two are corrections that a recording may reveal; their defaults correct nothing.
    `gravity_direction_in_base` is a unit vector, straight down on a level base.
    `mounting_rotation_rad` is a rotation vector: R_base_true = R_base_recorded @ exp([w]x), and
    all other fields and all readings are in the axes of the true sensor.
    """

    mass_kg: float
    com_m: Vector
    bias_force_N: Vector
    bias_torque_Nm: Vector
    gravity_direction_in_base: Vector = DOWN
    mounting_rotation_rad: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse a payload that cannot exist: every user of it would have to check."""
        for field in fields(self):
            numbers = np.atleast_1d(getattr(self, field.name))
            expected = 1 if field.name == "mass_kg" else 3
            if numbers.shape != (expected,) or not np.isfinite(numbers).all():
                raise DataError(f"payload: {field.name} must be {expected} finite number(s)")
        if self.mass_kg < 0.0:
            raise DataError(f"payload: mass_kg must not be negative, it is {self.mass_kg:g}")
        if abs(math.hypot(*self.gravity_direction_in_base) - 1.0) > UNIT_TOLERANCE:
            raise DataError("payload: gravity_direction_in_base must have length 1")


def gravity_in_sensor(payload: Payload, R_base_sensor: Array) -> Array:
    """Return g_s = (R_base_sensor R_mount)^T g [m/s^2], in the axes of the true sensor.

    Args:
        payload: Carries the direction of gravity and the mounting rotation.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
    """
    R_mount = rotation_from_vector(np.array(payload.mounting_rotation_rad))
    g_in_base = GRAVITY_M_S2 * np.array(payload.gravity_direction_in_base)
    return np.asarray(np.einsum("...ji,j->...i", R_base_sensor @ R_mount, g_in_base))


def predict(payload: Payload, R_base_sensor: Array) -> tuple[Array, Array]:
    """Return force [N] and torque [Nm] that the sensor reads at rest and free of contact.

    F = m g_s + b_F and M = c x m g_s + b_M: the load on the sensor, about its origin, in its axes
    (Kubus, Kroeger, Wahl: On-line rigid object recognition and pose estimation, IROS 2007).

    Args:
        payload: What hangs below the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
    """
    weight = payload.mass_kg * gravity_in_sensor(payload, R_base_sensor)
    moment = np.cross(np.array(payload.com_m), weight)
    return weight + np.array(payload.bias_force_N), moment + np.array(payload.bias_torque_Nm)


def residual(
    payload: Payload, R_base_sensor: Array, *, force_N: Array, torque_Nm: Array
) -> tuple[Array, Array]:
    """Return reading minus prediction, in sensor axes: what the environment does, or the error.

    Args:
        payload: What hangs below the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
        force_N: Reading in sensor axes. Shape (3,) or (n, 3).
        torque_Nm: Reading in sensor axes, about the sensor origin. Shape (3,) or (n, 3).
    """
    force, torque = predict(payload, R_base_sensor)
    return force_N - force, torque_Nm - torque


def save(payload: Payload, path: Path) -> None:
    """Write the YAML file that `load` reads. Raises DataError when it cannot be written."""
    data = {
        key: value if isinstance(value, float) else [float(x) for x in value]
        for key, value in asdict(payload).items()
    }
    text = "# forcemesh payload: kg, m, N, Nm, rad; sensor axes, from the sensor origin\n"
    text += yaml.safe_dump(data, sort_keys=False, default_flow_style=None)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def load(path: Path) -> Payload:
    """Read a payload file. Raises DataError naming file, key and what would be right."""
    data = _mapping(path)
    known = {field.name: field for field in fields(Payload)}
    for key in data:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"
            raise DataError(f"{path}: unknown key {key}{hint}")
    values: dict[str, Any] = {}
    for key in known:
        if key in data:
            value = data[key]
            values[key] = (
                _number(path, key, value) if key == "mass_kg" else _vector(path, key, value)
            )
        elif key in ("mass_kg", "com_m", "bias_force_N", "bias_torque_Nm"):
            raise DataError(f"{path}: key {key} is missing")
    try:
        return Payload(**values)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _mapping(path: Path) -> dict[Any, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is not UTF-8 text") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark is not None else ""
        raise DataError(f"{path}{where}: is not valid YAML") from error
    if not isinstance(data, dict):
        raise DataError(f"{path}: must hold the keys of a payload, such as mass_kg: 1.5")
    return data


def _vector(path: Path, key: str, value: Any) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise DataError(f"{path}: key {key} must be a list of 3 numbers, it is {value!r}")
    x, y, z = (_number(path, key, entry) for entry in value)
    return x, y, z


def _number(path: Path, key: str, value: Any) -> float:
    # YAML 1.1 reads 1e-3 (without a dot) as text, so text that is a number is taken as one.
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise DataError(f"{path}: key {key} must hold finite numbers, it holds {value!r}")
    return number

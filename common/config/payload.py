"""Payload of the force/torque sensor: its model, the readings it causes, and its YAML file."""

import difflib
import math
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from common.motion.frames import GRAVITY_M_S2, Array, rotation_from_vector
from forcemesh.errors import DataError
from forcemesh.units import beyond, mounting_objection

Vector = tuple[float, float, float]

DOWN: Vector = (0.0, 0.0, -1.0)
UNIT_TOLERANCE = 1e-3
GAIN_LEAST, GAIN_MOST = 0.5, 1.5  # outside: broken sensor, or wrong unit
# Larger values mean a wrong unit; the same limits as in common/config/calibration.py.
MOST = {
    "mass_kg": 50.0,
    "com_m": 1.0,
    "bias_force_N": 1000.0,
    "bias_torque_Nm": 100.0,
    "force_N": 1000.0,
    "torque_Nm": 100.0,
    "force_bend_N": 1000.0,
    "torque_bend_Nm": 100.0,
}
REACH = 1.0  # validity of the drift beyond the recording, in lengths of the recording


@dataclass(frozen=True, slots=True)
class BiasDrift:
    """Bias drift during the recording of a fit, for readings taken near that time.

    The first two are start and end on the clock of the recording. `force_N` and `torque_Nm` are the
    change of the bias between them, the bends its deviation from a straight line in between.
    """

    start_s: float
    end_s: float
    force_N: Vector
    torque_Nm: Vector
    force_bend_N: Vector = (0.0, 0.0, 0.0)
    torque_bend_Nm: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Reject invalid numbers, as Payload does."""
        _check_shapes(self, "payload: drift", ("start_s", "end_s"))
        if self.end_s <= self.start_s:
            raise DataError("payload: drift: end_s must be after start_s")

    def covers(self, time_s: Array) -> bool:
        """Return whether readings were taken near the recording, on the same clock."""
        reach = REACH * (self.end_s - self.start_s)
        return bool(time_s.min() >= self.start_s - reach and time_s.max() <= self.end_s + reach)

    def since_end(self, time_s: Array) -> tuple[Array, Array]:
        """Return the bias at each time relative to that at the end. Shapes (n, 3).

        Outside the recording the linear part is extrapolated over half its length, then the bias is
        constant: a warm-up slows down, and a random walk has no direction. The bend is not
        extrapolated.
        """
        u = 2.0 * (time_s - self.start_s) / (self.end_s - self.start_s) - 1.0
        change = ((np.clip(u, -2.0, 2.0) - 1.0) / 2.0)[:, None]
        bend = (np.clip(u, -1.0, 1.0) ** 2 - 1.0)[:, None]
        return (
            change * np.array(self.force_N) + bend * np.array(self.force_bend_N),
            change * np.array(self.torque_Nm) + bend * np.array(self.torque_bend_Nm),
        )


@dataclass(frozen=True, slots=True)
class Payload:
    """Weight and bias in sensor axes, about the sensor origin.

    The fields with defaults are corrections that a fit may identify; their defaults correct
    nothing. `gravity_direction_in_base` is a unit vector, straight down on a level base.
    `mounting_rotation_rad` is a rotation vector: R_base_true = R_base_recorded @ exp([w]x), and
    all other fields and all readings are in the axes of the true sensor. The gains are the reading
    of each axis per unit of load. The bias is that at the end of the recording; `drift` corrects
    earlier readings and has no effect without a time.
    """

    mass_kg: float
    com_m: Vector
    bias_force_N: Vector
    bias_torque_Nm: Vector
    gravity_direction_in_base: Vector = DOWN
    mounting_rotation_rad: Vector = (0.0, 0.0, 0.0)
    force_gain: Vector = (1.0, 1.0, 1.0)
    torque_gain: Vector = (1.0, 1.0, 1.0)
    drift: BiasDrift | None = None

    def __post_init__(self) -> None:
        """Reject an impossible payload, so that its users need no checks."""
        _check_shapes(self, "payload", ("mass_kg",))
        if self.mass_kg < 0.0:
            raise DataError(f"payload: mass_kg must not be negative, it is {self.mass_kg:g}")
        if abs(math.hypot(*self.gravity_direction_in_base) - 1.0) > UNIT_TOLERANCE:
            raise DataError("payload: gravity_direction_in_base must have length 1")
        for name in ("force_gain", "torque_gain"):
            gains = getattr(self, name)
            if min(gains) < GAIN_LEAST or max(gains) > GAIN_MOST:
                raise DataError(f"payload: {name} must be from {GAIN_LEAST:g} to {GAIN_MOST:g}")


def _check_shapes(data: Payload | BiasDrift, where: str, numbers: tuple[str, ...]) -> None:
    """Reject values that are not finite or of the wrong shape."""
    for field in fields(data):
        value = getattr(data, field.name)
        if field.name == "drift":
            continue
        found = np.atleast_1d(value)
        expected = 1 if field.name in numbers else 3
        if found.shape != (expected,) or not np.isfinite(found).all():
            raise DataError(f"{where}: {field.name} must be {expected} finite number(s)")


def gravity_in_sensor(payload: Payload, R_base_sensor: Array) -> Array:
    """Return g_s = (R_base_sensor R_mount)^T g [m/s^2], in the axes of the true sensor.

    Args:
        payload: Holds the direction of gravity and the mounting rotation.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
    """
    R_mount = rotation_from_vector(np.array(payload.mounting_rotation_rad))
    g_in_base = GRAVITY_M_S2 * np.array(payload.gravity_direction_in_base)
    return np.asarray(np.einsum("...ji,j->...i", R_base_sensor @ R_mount, g_in_base))


def predict(payload: Payload, R_base_sensor: Array) -> tuple[Array, Array]:
    """Return force [N] and torque [Nm] that the sensor reads at rest and without contact.

    F = k_F m g_s + b_F and M = k_M (c x m g_s) + b_M, gains k axis by axis: the load on the sensor,
    about its origin, in its axes (Kubus, Kroeger, Wahl: On-line rigid object recognition and pose
    estimation, IROS 2007).

    Args:
        payload: Payload of the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
    """
    force, torque = weight_in_sensor(payload, R_base_sensor)
    return (
        np.array(payload.force_gain) * force + np.array(payload.bias_force_N),
        np.array(payload.torque_gain) * torque + np.array(payload.bias_torque_Nm),
    )


def weight_in_sensor(payload: Payload, R_base_sensor: Array) -> tuple[Array, Array]:
    """Return the weight of the payload and its moment, as an ideal sensor would read them."""
    weight = payload.mass_kg * gravity_in_sensor(payload, R_base_sensor)
    return weight, np.cross(np.array(payload.com_m), weight)


def residual(
    payload: Payload,
    R_base_sensor: Array,
    *,
    force_N: Array,
    torque_Nm: Array,
    time_s: Array | None = None,
) -> tuple[Array, Array]:
    """Return true load minus weight, in sensor axes: load of the environment, or the residual.

    Args:
        payload: Payload of the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
        force_N: Reading in sensor axes. Shape (3,) or (n, 3).
        torque_Nm: Reading in sensor axes, about the sensor origin. Shape (3,) or (n, 3).
        time_s: Times of the readings on the clock of the fit, to apply its drift. Shape (n,).
    """
    force, torque = weight_in_sensor(payload, R_base_sensor)
    b_F, b_M = np.array(payload.bias_force_N), np.array(payload.bias_torque_Nm)
    if payload.drift is not None and time_s is not None:
        d_F, d_M = payload.drift.since_end(time_s)
        b_F, b_M = b_F + d_F, b_M + d_M
    return (
        (force_N - b_F) / np.array(payload.force_gain) - force,
        (torque_Nm - b_M) / np.array(payload.torque_gain) - torque,
    )


def save(payload: Payload, path: Path) -> None:
    """Write the YAML file that `load` reads. Raises DataError when it cannot be written."""
    data = _plain(asdict(payload))
    text = "# forcemesh payload: kg, m, N, Nm, rad; sensor axes, from the sensor origin\n"
    text += yaml.safe_dump(data, sort_keys=False, default_flow_style=None)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def _plain(data: dict[str, Any]) -> dict[str, Any]:
    """Return plain YAML types: lists for tuples; fields that are None are omitted."""
    plain: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, dict):
            plain[key] = _plain(value)
        elif value is not None:
            plain[key] = value if isinstance(value, float) else [float(x) for x in value]
    return plain


def load(path: Path) -> Payload:
    """Read a payload file. Raises DataError naming file, key and expected value."""
    data = _mapping(path)
    try:
        values = _values(path, data, Payload, "")
        if "drift" in data:
            values["drift"] = BiasDrift(
                **_values(path, _submapping(path, data), BiasDrift, "drift: ")
            )
        return Payload(**values)
    except DataError as error:
        raise DataError(str(error) if str(path) in str(error) else f"{path}: {error}") from error


def _values(path: Path, data: dict[Any, Any], kind: type, where: str) -> dict[str, Any]:
    """Return the numbers and vectors of a mapping, with keys checked against those of `kind`."""
    known = {field.name: field for field in fields(kind)}
    for key in data:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"
            raise DataError(f"{path}: unknown key {where}{key}{hint}")
    values: dict[str, Any] = {}
    for key, field in known.items():
        if key in data and key != "drift":
            read = _number if field.type is float else _vector
            values[key] = read(path, where + key, data[key])
        elif key not in data and field.default is MISSING:
            raise DataError(f"{path}: key {where}{key} is missing")
    for key, value in values.items():
        _refuse_implausible(f"{path}: key {where}{key}", key, value)
    return values


def _refuse_implausible(where: str, key: str, value: float | Vector) -> None:
    """Reject values that suggest a wrong unit."""
    if key == "mounting_rotation_rad" and isinstance(value, tuple):
        if objection := mounting_objection(value):
            raise DataError(f"{where}: {objection}")
        return
    limit = MOST.get(key)
    for number in value if isinstance(value, tuple) else (value,):
        if limit is not None and abs(number) > limit:
            kind = "less_than_equal" if number > 0.0 else "greater_than_equal"
            text = beyond(kind, key, number, limit if number > 0.0 else -limit)
            raise DataError(f"{where} {text}")


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


def _submapping(path: Path, data: dict[Any, Any]) -> dict[Any, Any]:
    drift = data["drift"]
    if not isinstance(drift, dict):
        raise DataError(f"{path}: key drift must be a mapping with start_s, end_s and vectors")
    return drift


def _vector(path: Path, key: str, value: Any) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise DataError(f"{path}: key {key} must be a list of 3 numbers, it is {value!r}")
    x, y, z = (_number(path, key, entry) for entry in value)
    return x, y, z


def _number(path: Path, key: str, value: Any) -> float:
    # YAML 1.1 reads 1e-3 (without a dot) as text, so text that is a number is accepted.
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise DataError(f"{path}: key {key} must hold finite numbers, it holds {value!r}")
    return number

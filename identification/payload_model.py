"""Payload model: its unknowns, prediction, derivatives and priors.

    F = (1 + e_F) * m g_s + b_F(t)        M = (1 + e_M) * (h x g_s) + b_M(t)
    g_s = (R_base_sensor R_mount)^T g     b(t) = b + d1 u/2 + d2 (u^2 - 1/3)

with h = m c, `*` axis by axis, and u = -1 at the first pose, +1 at the last: d1 is the change of
the bias over the recording, d2 the height of its bend.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from common.motion.frames import (
    GRAVITY_M_S2,
    Array,
    rotation_from_vector,
    skew,
    vector_from_rotation,
)
from identification.recording import Samples

LINEAR = 10
LARGEST_TURN_RAD = 0.5  # limit of one step; a longer one leaves the region of descent
LARGEST_GAIN_ERROR = 0.5
DOWN = np.array([0.0, 0.0, -1.0])
# Places of the errors that are added to each other, in `State.errors`.
ERRORS = {
    "gain_F": (0, 0),
    "gain_M": (0, 1),
    "drift1_F": (1, 0),
    "drift1_M": (1, 1),
    "drift2_F": (2, 0),
    "drift2_M": (2, 1),
}
DRIFT_AT_END = np.array([0.5, 2.0 / 3.0])  # u/2 and u^2 - 1/3 at the end of the recording


@dataclass(frozen=True, slots=True)
class Model:
    """Parameters that are fitted beyond mass, moment and bias; drift 2 is quadratic."""

    tilt: bool = False
    mounting: bool = False
    gain: bool = False
    drift: int = 0

    @property
    def name(self) -> str:
        """Return the parameters beyond the plain model, joined by plus signs."""
        names = [name for name in ("tilt", "mounting", "gain") if getattr(self, name)]
        names += [("drift", "curved drift")[self.drift - 1]] if self.drift else []
        return "+".join(names) or "plain"

    @property
    def groups(self) -> int:
        """Return the number of errors that it corrects; quadratic drift counts twice."""
        return self.tilt + self.mounting + self.gain + self.drift

    @property
    def places(self) -> Mapping[str, slice]:
        """Return the slice of each group of unknowns, the linear ones first."""
        return _places(self)

    @property
    def size(self) -> int:
        """Return the number of unknowns."""
        return LINEAR + 2 * self.tilt + 3 * self.mounting + 6 * (self.gain + self.drift)


@cache
def _places(model: Model) -> Mapping[str, slice]:
    is_fitted = model.gain, model.drift >= 1, model.drift >= 2
    sizes = {"mass": 1, "moment": 3, "bias_F": 3, "bias_M": 3}
    sizes |= {"tilt": 2 * model.tilt, "mounting": 3 * model.mounting}
    sizes |= {name: 3 * is_fitted[row] for name, (row, _) in ERRORS.items()}
    places, at = {}, 0
    for name, size in sizes.items():
        if size:
            places[name] = slice(at, at + size)
            at += size
    return MappingProxyType(places)


# Prior standard deviation of one component of each error. Recordings that show more widen it.
PRIOR_STD = {
    "tilt": math.radians(1.0),
    "mounting": math.radians(2.0),
    "gain_F": 0.03,
    "gain_M": 0.03,
    "drift1_F": 1.0,  # [N]
    "drift1_M": 0.03,  # [N m]
    "drift2_F": 0.4,
    "drift2_M": 0.012,
}
NAMES = {
    "moment": "moment",
    "bias_F": "bias_force",
    "bias_M": "bias_torque",
    "tilt": "gravity_tilt",
    "mounting": "mounting_rotation",
    "gain_F": "force_gain",
    "gain_M": "torque_gain",
    "drift1_F": "drift_force",
    "drift1_M": "drift_torque",
    "drift2_F": "force_bend",
    "drift2_M": "torque_bend",
}


@dataclass(frozen=True, slots=True)
class State:
    """Unknowns: mass [kg], first moment h [kg m], bias force [N] and torque [Nm], errors.

    `linear` is (m, h, b_F, b_M), shape (10,), the bias in the mean of the recording;
    `down_in_base` a unit vector; `R_mount` (3, 3); `errors` is (e, d1 [N, Nm], d2 [N, Nm]), each of
    force and torque, shape (3, 2, 3).
    """

    linear: Array
    down_in_base: Array
    R_mount: Array
    errors: Array

    @property
    def gain(self) -> Array:
        """Return the gains of force and torque. Shape (2, 3)."""
        return np.asarray(1.0 + self.errors[0])

    @property
    def drift(self) -> Array:
        """Return d1 and d2 of force and torque [N, Nm]. Shape (2, 2, 3)."""
        return self.errors[1:]


def start_state() -> State:
    """Return level gravity, no mounting rotation, no payload, no error."""
    return State(np.zeros(LINEAR), DOWN, np.eye(3), np.zeros((3, 2, 3)))


def level_base(down_in_base: Sequence[float] | Array) -> Array:
    """Return R_level_base: a base turned so that the nominal gravity points along its -z.

    The fit takes gravity along -z as nominal; on a wall or a ceiling it works in that base.
    """
    down = np.asarray(down_in_base, dtype=np.float64)
    return np.asarray(pin.Quaternion.FromTwoVectors(down, DOWN).matrix())


def drift_shapes(samples: Samples) -> Array:
    """Return u/2 and u^2 - 1/3 for each reading: zeros without times. Shape (2, n)."""
    t = samples.time_s
    if t is None or np.ptp(t) == 0.0:
        return np.zeros((2, len(samples)))
    u = 2.0 * (t - t.min()) / np.ptp(t) - 1.0
    return np.stack([u / 2.0, u**2 - 1.0 / 3.0])


def bias_at_end(model: Model) -> Array:
    """Return the derivatives of the bias at the end of the recording. Shape (6, model.size)."""
    J = np.eye(6, model.size, k=4)
    for name, (row, block) in ERRORS.items():
        if row > 0 and name in model.places:
            J[3 * block : 3 * block + 3, model.places[name]] = DRIFT_AT_END[row - 1] * np.eye(3)
    return J


def gravity_in_sensor(R_base_sensor: Array, down_in_base: Array) -> Array:
    """Return g_s = R^T g in each attitude [m/s^2]. Shape (n, 3, 3) to (n, 3)."""
    return np.asarray(R_base_sensor.swapaxes(1, 2) @ (GRAVITY_M_S2 * down_in_base))


def residuals(state: State, samples: Samples) -> Array:
    """Return reading minus model: force [N] and torque [Nm]. Shape (2, n, 3)."""
    g_s = gravity_in_sensor(samples.R_base_sensor @ state.R_mount, state.down_in_base)
    m, h = state.linear[0], state.linear[1:4]
    load = np.array([m * g_s, g_s @ skew(h).T])
    bias = state.linear[4:].reshape(2, 1, 3)
    if state.drift.any():
        bias = bias + drift_shapes(samples).T @ state.drift.swapaxes(0, 1)
    read = np.array([samples.force_N, samples.torque_Nm])
    return np.asarray(read - state.gain[:, None, :] * load - bias)


def jacobian(state: State, samples: Samples, model: Model) -> Array:
    """Return the derivatives of the model's force and torque. Shape (2, n, 3, model.size)."""
    R, down = samples.R_base_sensor @ state.R_mount, state.down_in_base
    g_s = gravity_in_sensor(R, down)
    m, h = state.linear[0], state.linear[1:4]
    J = np.zeros((2, len(samples), 3, model.size))
    J[0, :, :, 0] = g_s
    J[1, :, :, 1:4] = -skew_matrices(g_s)
    places = model.places
    if model.tilt:  # g' = exp([e]x) g, e perpendicular to g
        g_jacobian = R.swapaxes(1, 2) @ -skew(GRAVITY_M_S2 * down) @ perpendicular_axes(down)
        J[:, :, :, places["tilt"]] = m * g_jacobian, skew(h) @ g_jacobian
    if model.mounting:  # R_mount' = R_mount exp([d]x), so g_s' = g_s + [g_s]x d
        g_jacobian = skew_matrices(g_s)
        J[:, :, :, places["mounting"]] = m * g_jacobian, skew(h) @ g_jacobian
    J *= state.gain[:, None, :, None]
    J[0, :, :, 4:7] = J[1, :, :, 7:10] = np.eye(3)
    load, shapes = (m * g_s, g_s @ skew(h).T), drift_shapes(samples)
    for name, (row, block) in ERRORS.items():
        if name in places:
            factor = load[block] if row == 0 else shapes[row - 1][:, None]
            J[block, :, :, places[name]] = factor[:, :, None] * np.eye(3)
    return J


def extra_parameters(state: State, model: Model) -> dict[str, Array]:
    """Return the value of each group beyond the linear unknowns, as used by the priors."""
    values = {}
    if model.tilt:
        down = state.down_in_base
        turn = pin.Quaternion.FromTwoVectors(DOWN if down[2] <= 0.0 else -DOWN, down)
        values["tilt"] = perpendicular_axes(down).T @ vector_from_rotation(turn.matrix())
    if model.mounting:
        values["mounting"] = vector_from_rotation(state.R_mount)
    return values | {
        name: state.errors[place] for name, place in ERRORS.items() if name in model.places
    }


def updated_state(state: State, step: Array, model: Model) -> State:
    """Return the state after a step of the unknowns, in the order of the Jacobian's columns."""
    parts = {name: step[place] for name, place in model.places.items()}
    turn_rad = math.hypot(*step[LINEAR : LINEAR + 2 * model.tilt + 3 * model.mounting])
    shorter = LARGEST_TURN_RAD / max(turn_rad, LARGEST_TURN_RAD)
    down, R_mount = state.down_in_base, state.R_mount
    if model.tilt:
        down = rotation_from_vector(perpendicular_axes(down) @ parts["tilt"] * shorter) @ down
        down = down / math.hypot(*down)
    if model.mounting:
        R_mount = R_mount @ rotation_from_vector(parts["mounting"] * shorter)
    errors = state.errors.copy()
    for name, place in ERRORS.items():
        if name in parts:
            errors[place] += parts[name]
    errors[0] = np.clip(errors[0], -LARGEST_GAIN_ERROR, LARGEST_GAIN_ERROR)
    return State(state.linear + step[:LINEAR], down, R_mount, errors)


def make_mass_positive(state: State) -> State:
    """Make the mass positive: a negative one is the same as gravity pointing up."""
    if state.linear[0] >= 0.0:
        return state
    signs = np.array([-1.0] * 4 + [1.0] * 6)
    return replace(state, linear=state.linear * signs, down_in_base=-state.down_in_base)


def perpendicular_axes(direction: Array) -> Array:
    """Return two unit vectors perpendicular to a direction. Shape (3, 2)."""
    cross_matrix = skew(direction)
    first = cross_matrix[:, int(np.argmin(np.abs(direction)))]
    first = first / math.sqrt(first @ first)
    return np.stack([first, cross_matrix @ first], axis=1)


def skew_matrices(v: Array) -> Array:
    """Return [v]x for each row. Shape (n, 3) to (n, 3, 3)."""
    return np.cross(np.eye(3), v[:, None, :])  # its rows are e_x x v, e_y x v, e_z x v

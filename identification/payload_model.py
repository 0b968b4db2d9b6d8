"""Payload model: its unknowns, prediction, derivatives and priors.

    F = (1 + e_F) * m g_s + b_F(t)        M = (1 + e_M) * (h x g_s) + b_M(t)
    g_s = (R_base_sensor R_mount)^T g     b(t) = b + d1 u/2 + d2 (u^2 - 1/3)

with h = m c, `*` axis by axis, and u = -1 at the first pose, +1 at the last: d1 is the change of
the bias over the recording, d2 the height of its bend.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

import numpy as np

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
DOWN = np.array([0.0, 0.0, -1.0])
# Prior standard deviation of one component of each error. Recordings that show more widen it.
# Force and torque of one group are adjacent.
TILT_RAD, MOUNTING_RAD = np.radians(1.0), np.radians(2.0)
GAIN = 0.03
DRIFT_N, DRIFT_NM = 1.0, 0.03
BEND = 0.4  # of the drift


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
        """Return the slice of each group of unknowns after the linear ones."""
        return _places(self)

    @property
    def size(self) -> int:
        """Return the number of unknowns."""
        return LINEAR + 2 * self.tilt + 3 * self.mounting + 6 * (self.gain + self.drift)


@cache
def _places(model: Model) -> Mapping[str, slice]:
    sizes = {"tilt": 2 * model.tilt, "mounting": 3 * model.mounting}
    sizes |= {"gain_F": 3 * model.gain, "gain_M": 3 * model.gain}
    for order in range(1, model.drift + 1):
        sizes |= {f"drift{order}_F": 3, f"drift{order}_M": 3}
    places, at = {}, LINEAR
    for name, size in sizes.items():
        if size:
            places[name] = slice(at, at + size)
            at += size
    return MappingProxyType(places)


PRIOR_STD = {
    "tilt": float(TILT_RAD),
    "mounting": float(MOUNTING_RAD),
    "gain_F": GAIN,
    "gain_M": GAIN,
    "drift1_F": DRIFT_N,
    "drift1_M": DRIFT_NM,
    "drift2_F": BEND * DRIFT_N,
    "drift2_M": BEND * DRIFT_NM,
}
NAMES = {
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
    `down_in_base` a unit vector; `R_mount` (3, 3); `gain_error` (e_F, e_M), shape (2, 3); `drift`
    is (d1, d2) of force and torque [N, Nm], shape (2, 2, 3).
    """

    linear: Array
    down_in_base: Array
    R_mount: Array
    gain_error: Array
    drift: Array


def start_state() -> State:
    """Return level gravity, no mounting rotation, no payload, no error."""
    return State(np.zeros(LINEAR), DOWN, np.eye(3), np.zeros((2, 3)), np.zeros((2, 2, 3)))


def drift_shapes(samples: Samples) -> Array:
    """Return u/2 and u^2 - 1/3 for each reading: zeros without times. Shape (2, n)."""
    t = samples.time_s
    if t is None or np.ptp(t) == 0.0:
        return np.zeros((2, len(samples)))
    u = 2.0 * (t - t.min()) / np.ptp(t) - 1.0
    return np.stack([u / 2.0, u**2 - 1.0 / 3.0])


def gravity(state: State, samples: Samples) -> Array:
    """Return g_s of each reading [m/s^2]. Shape (n, 3)."""
    g = GRAVITY_M_S2 * state.down_in_base
    return np.asarray((samples.R_base_sensor @ state.R_mount).swapaxes(1, 2) @ g)


def residuals(state: State, samples: Samples) -> Array:
    """Return reading minus model: force [N] and torque [Nm]. Shape (2, n, 3)."""
    g_s = gravity(state, samples)
    m, h = state.linear[0], state.linear[1:4]
    load = np.array([m * g_s, g_s @ skew(h).T])
    bias = state.linear[4:].reshape(2, 1, 3)
    if state.drift.any():
        bias = bias + drift_shapes(samples).T @ state.drift.swapaxes(0, 1)
    read = np.array([samples.force_N, samples.torque_Nm])
    return np.asarray(read - (1.0 + state.gain_error[:, None, :]) * load - bias)


def jacobian(state: State, samples: Samples, model: Model) -> Array:
    """Return the derivatives of the model's force and torque. Shape (2, n, 3, model.size)."""
    g_s, n = gravity(state, samples), len(samples)
    m, h = state.linear[0], state.linear[1:4]
    J = np.zeros((2, n, 3, model.size))
    J[0, :, :, 0] = g_s
    J[1, :, :, 1:4] = -skew_matrices(g_s)
    places = model.places
    if model.tilt:  # g' = exp([e]x) g, e perpendicular to g
        tilt_jacobian = -skew(GRAVITY_M_S2 * state.down_in_base) @ perpendicular_axes(
            state.down_in_base
        )
        g_jacobian = (samples.R_base_sensor @ state.R_mount).swapaxes(1, 2) @ tilt_jacobian
        J[:, :, :, places["tilt"]] = m * g_jacobian, skew(h) @ g_jacobian
    if model.mounting:  # R_mount' = R_mount exp([d]x), so g_s' = g_s + [g_s]x d
        g_jacobian = skew_matrices(g_s)
        J[:, :, :, places["mounting"]] = m * g_jacobian, skew(h) @ g_jacobian
    J *= (1.0 + state.gain_error)[:, None, :, None]
    J[0, :, :, 4:7] = J[1, :, :, 7:10] = np.eye(3)
    if model.gain:
        J[0, :, :, places["gain_F"]] = (m * g_s)[:, :, None] * np.eye(3)
        J[1, :, :, places["gain_M"]] = (g_s @ skew(h).T)[:, :, None] * np.eye(3)
    for order, shape in enumerate(
        drift_shapes(samples)[: model.drift] if model.drift else (), start=1
    ):
        for block, of in enumerate("FM"):
            J[block, :, :, places[f"drift{order}_{of}"]] = shape[:, None, None] * np.eye(3)
    return J


def extra_parameters(state: State, model: Model) -> dict[str, Array]:
    """Return the value of each group beyond the linear unknowns, as used by the priors."""
    values = {}
    if model.tilt:
        level = DOWN if state.down_in_base[2] <= 0.0 else -DOWN
        tilt_axis = skew(level) @ state.down_in_base
        sine = math.sqrt(tilt_axis @ tilt_axis)
        angle = math.atan2(sine, level @ state.down_in_base)
        values["tilt"] = (
            perpendicular_axes(state.down_in_base).T @ tilt_axis * (angle / max(sine, 1e-12))
        )
    if model.mounting:
        values["mounting"] = vector_from_rotation(state.R_mount)
    if model.gain:
        values |= {"gain_F": state.gain_error[0], "gain_M": state.gain_error[1]}
    for order in range(1, model.drift + 1):
        d_F, d_M = state.drift[order - 1]
        values |= {f"drift{order}_F": d_F, f"drift{order}_M": d_M}
    return values


def updated_state(state: State, step: Array, model: Model) -> State:
    """Return the state after a step of the unknowns, in the order of the Jacobian's columns."""
    parts = {name: step[place] for name, place in model.places.items()}
    rotations = [parts[name] for name in ("tilt", "mounting") if name in parts]
    size = float(np.linalg.norm(np.concatenate(rotations))) if rotations else 0.0
    shorter = min(1.0, LARGEST_TURN_RAD / size) if size else 1.0
    down, R_mount = state.down_in_base, state.R_mount
    if model.tilt:
        down = rotation_from_vector(perpendicular_axes(down) @ parts["tilt"] * shorter) @ down
        down = down / np.linalg.norm(down)
    if model.mounting:
        R_mount = R_mount @ rotation_from_vector(parts["mounting"] * shorter)
    gain, drift = state.gain_error.copy(), state.drift.copy()
    for block, of in enumerate("FM"):
        if model.gain:
            gain[block] = np.clip(gain[block] + parts[f"gain_{of}"], -0.5, 0.5)
        for order in range(1, model.drift + 1):
            drift[order - 1, block] += parts[f"drift{order}_{of}"]
    return State(state.linear + step[:LINEAR], down, R_mount, gain, drift)


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
    matrices = np.zeros((len(v), 3, 3))
    matrices[:, (2, 0, 1), (1, 2, 0)] = v
    matrices[:, (1, 2, 0), (2, 0, 1)] = -v
    return matrices

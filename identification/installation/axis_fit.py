"""Signed axis permutation of a sensor's channels, one of 48, from weight and moment. Pure.

    F = m P D g_s + b_F        M = B D (c x m g_s) + b_M        g_s = R_base_sensor^T g

P and B are signed permutations (rows: channels, columns: axes), D a rotation that both share: the
part of a mounting that is not a multiple of 90 degrees. Both problems are solved in closed form
(Kabsch 1976 for the force; for each B the moment is linear in c), so nothing can fail to converge.
"""

from dataclasses import dataclass
from itertools import permutations, product
from math import hypot

import numpy as np

from common.motion.frames import GRAVITY_M_S2, Array, skew
from identification.payload_fit import gravity_in_sensor, half_course
from identification.recording import Poses
from identification.static_poses import angle

# Model errors must not read as another permutation: gain, tilt, mounting, drift (docs/payload.md).
MISFIT_SHARE = 0.10  # of the weight, rms; larger residuals are not explained
MISFIT_N, MISFIT_MOST_SHARE = 0.5, 0.3  # drift hides a light tool sooner
CLEAR_TIMES, CLEAR_SHARE = 3.0, 0.05  # margin to a rival: of the rms, of the weight
MOMENT_SHARE, MOMENT_NM = 0.06, 0.003  # the same for moments
MOMENT_MISFIT_SHARE, MOMENT_MISFIT_NM = 0.25, 0.02
LEAST_POSES_FOR_AXES = (1, 6, 10)  # for a drift of order 0, 1, 2
TURNED_RAD, TURNED_TIMES = np.radians(8.0), 2.0  # less is not another mounting; times the rms
EYE = np.eye(3)
SIGNED = np.array(  # the identity first
    [
        np.diag(signs) @ EYE[list(order)]
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
)
SIGNED.setflags(write=False)
TURNS = SIGNED[np.linalg.det(SIGNED) > 0.0]  # the 24 that a mounting can have


@dataclass(frozen=True, slots=True)
class ForceFit:
    """Fit of the force channels to the weight.

    `wiring` is P, `rotation` D; `mass` is in kg if the readings are in N. `rival_rms_N` is the
    residual of the next best permutation.
    """

    wiring: Array
    rotation: Array
    mass: float
    rms_N: float
    rival_rms_N: float
    spread_N: float
    explained: bool
    determined: bool

    @property
    def turned(self) -> bool:
        """Return whether the axes differ from any permutation by more than mounting play."""
        force_N = self.weight_N * self.turn_rad
        return self.turn_rad >= TURNED_RAD and force_N > TURNED_TIMES * self.rms_N

    @property
    def turn_rad(self) -> float:
        """Return the angle between the axes and the nearest permutation [rad]."""
        return turn_angle(self.rotation)

    @property
    def weight_N(self) -> float:
        """Return the measured weight [N]."""
        return self.mass * GRAVITY_M_S2


@dataclass(frozen=True, slots=True)
class TorqueFit:
    """One explanation of the moments: permutation B and its centre of mass [m]."""

    wiring: Array
    com_m: Array
    rms_Nm: float


@dataclass(frozen=True, slots=True)
class TorqueFits:
    """Every permutation of the torque channels that explains the moments, the best one first.

    Each is followed by its opposite: -B with -c gives the same moments.
    """

    fits: tuple[TorqueFit, ...]
    spread_Nm: float
    explained: bool

    @property
    def shown(self) -> bool:
        """Return whether the tool's moment excludes any permutation."""
        return self.explained and len(self.fits) < len(SIGNED)


def turn_angle(R: Array) -> float:
    """Return the angle of a rotation [rad]."""
    return float(angle(EYE, R))


def nearest_wiring(Q: Array) -> Array:
    """Return the signed permutation nearest to an orthogonal matrix. Shape (3, 3)."""
    return np.array(SIGNED[int(np.argmax(np.einsum("nij,ij->n", SIGNED, Q)))])


def _centred(values: Array, poses: Poses, drift: int = 0) -> Array:
    """Return values less bias and drift, times the roots of the weights, which add up to one.

    Args:
        values: One row for each pose. Shape (n, k).
        poses: Their weights and times.
        drift: 0 for a constant bias, 1 for a linear, 2 for a quadratic one.
    """
    root = np.sqrt(poses.weight / poses.weight.sum())
    half = half_course(poses.means)
    shapes = (half, half**2)[:drift]
    basis = np.stack([np.ones(len(poses)), *shapes], axis=1) * root[:, None]
    scaled = values * root[:, None]
    return np.asarray(scaled - basis @ np.linalg.pinv(basis) @ scaled)


def gravity_turns(poses: Poses, down_in_base: Array) -> bool:
    """Return whether gravity spans two directions in the sensor; the rivals cover the third."""
    G = _centred(gravity_in_sensor(poses.means.R_base_sensor, down_in_base), poses)
    return bool(np.sqrt(np.linalg.eigvalsh(G.T @ G)[1]) > CLEAR_SHARE * GRAVITY_M_S2)


def fit_force(poses: Poses, down_in_base: Array, drift: int = 0) -> ForceFit:
    """Find the permutation, rotation and mass that fit the forces best.

    Args:
        poses: Static readings, free of contact, any four attitudes or more.
        down_in_base: Where gravity points. Unit vector, shape (3,).
        drift: Order of the bias as a polynomial of time: 0, 1 or 2.
    """
    F = _centred(poses.means.force_N, poses, drift)
    g_s = gravity_in_sensor(poses.means.R_base_sensor, down_in_base)
    G = _centred(g_s, poses, drift)
    H, gg, ff = F.T @ G, float(np.sum(G * G)), float(np.sum(F * F))

    def mass_of(Q: Array) -> float:
        return max(0.0, float(np.sum(Q * H))) / gg if gg > 0.0 else 0.0

    def rms_of(Q: Array) -> float:
        return float(np.sqrt(max(0.0, ff - mass_of(Q) ** 2 * gg)))

    U, _, Vt = np.linalg.svd(H)
    candidates = (U @ np.diag([1.0, 1.0, det]) @ Vt for det in (1.0, -1.0))
    best, mirrored = sorted(candidates, key=rms_of)
    wiring = nearest_wiring(best)
    mass, rms_N = mass_of(best), rms_of(best)
    rival_rms_N = min(rms_of(Q) for Q in (mirrored, *(SIGNED[1:] @ best)))
    weight = mass * GRAVITY_M_S2
    most_N = max(MISFIT_SHARE * weight, min(MISFIT_N, MISFIT_MOST_SHARE * weight))
    margin_N = float(np.sqrt(max(0.0, rival_rms_N**2 - rms_N**2)))
    return ForceFit(
        wiring=wiring,
        rotation=wiring.T @ best,
        mass=mass,
        rms_N=rms_N,
        rival_rms_N=rival_rms_N,
        spread_N=float(np.sqrt(ff)),
        explained=mass > 0.0 and rms_N <= most_N,
        determined=margin_N > max(CLEAR_TIMES * rms_N, CLEAR_SHARE * weight),
    )


def fit_force_drifting(poses: Poses, down_in_base: Array) -> ForceFit:
    """Return the fit with the lowest order of drift that explains the forces, else of order 0."""
    fits = [fit_force(poses, down_in_base, drift) for drift in _drift_orders(poses)]
    return next((fit for fit in fits if fit.explained and fit.determined), fits[0])


def _drift_orders(poses: Poses) -> list[int]:
    """Return the orders of drift that the number of poses supports."""
    return [drift for drift, least in enumerate(LEAST_POSES_FOR_AXES) if len(poses) >= least]


def fit_torque(poses: Poses, down_in_base: Array, rotation: Array, mass: float) -> TorqueFits:
    """Find the permutations of the torque channels that explain the moments of a known weight.

    The lowest order of drift that explains them is used, else order 0.

    Args:
        poses: Static readings, free of contact.
        down_in_base: Where gravity points. Unit vector, shape (3,).
        rotation: D of the force fit. Shape (3, 3).
        mass: Mass of the tool, true or as read: the lever scales with it.
    """
    weight = mass * gravity_in_sensor(poses.means.R_base_sensor, down_in_base)
    fits = [_fit_torque(poses, weight, rotation, drift) for drift in _drift_orders(poses)]
    return next((fit for fit in fits if fit.explained), fits[0])


def _fit_torque(poses: Poses, weight: Array, rotation: Array, drift: int) -> TorqueFits:
    M = _centred(poses.means.torque_Nm, poses, drift)
    W = _centred(weight, poses, drift) @ rotation.T
    gram = W.T @ W
    K = np.trace(gram) * np.eye(3) - gram
    # The lever is undetermined about axes where the weight hardly moves: the inverse is damped.
    K_inverse = np.linalg.inv(K + 1e-9 * np.trace(K) * np.eye(3))
    fits = []
    for B in TURNS:
        y = M @ B  # rows B^T M
        lever = K_inverse @ np.cross(W, y).sum(axis=0)
        rms = float(np.linalg.norm(y - W @ skew(lever).T))
        fits.append(TorqueFit(B, rotation.T @ lever, rms))
    fits.sort(key=lambda fit: fit.rms_Nm)
    spread, best = float(np.linalg.norm(M)), fits[0].rms_Nm
    least_margin = max(CLEAR_TIMES * best, MOMENT_SHARE * spread, MOMENT_NM)
    pairs = (
        each
        for fit in fits
        if fit.rms_Nm**2 - best**2 <= least_margin**2
        for each in (fit, TorqueFit(-fit.wiring, -fit.com_m, fit.rms_Nm))
    )
    explained = best <= max(MOMENT_MISFIT_SHARE * spread, MOMENT_MISFIT_NM)
    return TorqueFits(tuple(pairs), spread, explained)


def free_gain(poses: Poses, down_in_base: Array) -> tuple[Array, float]:
    """Return A of F = A g_s + b, A unconstrained, shape (3, 3), and the residual [N]."""
    F = _centred(poses.means.force_N, poses)
    G = _centred(gravity_in_sensor(poses.means.R_base_sensor, down_in_base), poses)
    A_transposed, *_ = np.linalg.lstsq(G, F, rcond=1e-6)
    return np.asarray(A_transposed.T, dtype=np.float64), float(np.linalg.norm(F - G @ A_transposed))


def free_gravity(poses: Poses) -> tuple[Array, float]:
    """Return the direction of gravity in base that fits correct axes best, and the residual [N].

    F = R_base_sensor^T v + b, v unconstrained: an arm on a wall or a ceiling.
    """
    F = _centred(poses.means.force_N, poses).ravel()
    columns = poses.means.R_base_sensor.swapaxes(1, 2).reshape(-1, 9)
    X = _centred(columns, poses).reshape(-1, 3)
    v, *_ = np.linalg.lstsq(X, F, rcond=1e-6)
    direction = v / max(float(np.linalg.norm(v)), 1e-12)
    return np.asarray(direction, dtype=np.float64), hypot(*F - X @ v)


def nominal_rms(poses: Poses, down_in_base: Array) -> float:
    """Return the residual [N] of correct axes with gravity in this direction, and a mass."""
    F = _centred(poses.means.force_N, poses)
    G = _centred(gravity_in_sensor(poses.means.R_base_sensor, down_in_base), poses)
    mass = max(0.0, float(np.sum(F * G))) / max(float(np.sum(G * G)), 1e-12)
    return float(np.linalg.norm(F - mass * G))

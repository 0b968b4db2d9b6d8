"""Tells which pose would teach the most: the attitude that makes the worst-known number surer."""

from dataclasses import dataclass

import numpy as np

from common.motion.frames import Array, R_from_quaternion, quaternion_from_R
from identification.estimates import END
from identification.least_squares import Solution
from identification.payload_model import LINEAR, NAMES, USUAL, Model, jacobian
from identification.recording import Samples

ATTITUDES = 200
TEACHES = 0.05  # of the variance, at least, is what a new pose should take away
# What a person would call unsure: mass [kg], com [m], bias [N], [Nm].
LINEAR_SIZES = (0.1, 0.01, 1.0, 0.1)


@dataclass(frozen=True, slots=True)
class NextPose:
    """An attitude of the sensor in base, and what it does for the number that is known worst."""

    quaternion: tuple[float, float, float, float]
    down_in_sensor: tuple[float, float, float]
    parameter: str
    std_before: float
    std_after: float


def next_pose(solution: Solution) -> NextPose:
    """Return the best of many attitudes, all round: the arm may not reach it, its neighbours do.

    The number known worst has the largest standard deviation as a share of its usual size. A
    reading in attitude k with Jacobian J and noise S turns the covariance C into
    C - C J^T (S + J C J^T)^-1 J C. A number that no pose makes surer is passed over.
    """
    model = solution.model
    sizes = _sizes(solution)
    variance = np.diag(solution.covariance)
    R = _attitudes()
    ones = np.zeros((ATTITUDES, 3))
    J = jacobian(solution.state, Samples(R, ones, ones), model)
    for order in range(1, model.drift + 1):  # it would be read right after the recording
        for block, of in enumerate("FM"):
            J[block, :, :, model.places[f"drift{order}_{of}"]] = END[order - 1] * np.eye(3)
    rows = J.transpose(1, 0, 2, 3).reshape(ATTITUDES, 6, model.size)
    noise = np.repeat([solution.noise.force_N, solution.noise.torque_Nm], 3) ** 2
    shared = rows @ solution.covariance
    spread = np.diag(noise) + shared @ rows.swapaxes(1, 2)
    taken = np.einsum("kri,kri->ki", shared, np.linalg.solve(spread, shared))
    by_size = [int(i) for i in np.argsort(-variance / sizes**2)]
    teachable = [i for i in by_size if taken[:, i].max() > TEACHES * variance[i]]
    worst = (teachable or by_size)[0]
    best = int(np.argmax(taken[:, worst]))
    down = R[best].T @ solution.state.down_in_base
    return NextPose(
        quaternion=quaternion_from_R(R[best]),
        down_in_sensor=(float(down[0]), float(down[1]), float(down[2])),
        parameter=_names(model)[worst],
        std_before=float(np.sqrt(variance[worst])),
        std_after=float(np.sqrt(max(variance[worst] - taken[best, worst], 0.0))),
    )


def _attitudes() -> Array:
    rng = np.random.default_rng(0)  # the same every time: the advice does not change by itself
    q = rng.normal(size=(ATTITUDES, 4))
    return np.array([R_from_quaternion(row) for row in q])


def _sizes(solution: Solution) -> Array:
    """Return what one calls a large error of each unknown."""
    mass, com, bias_F, bias_M = LINEAR_SIZES
    model, moment = solution.model, com * float(solution.state.linear[0])
    sizes = np.empty(model.size)
    sizes[:LINEAR] = [mass, *[moment] * 3, *[bias_F] * 3, *[bias_M] * 3]
    for name, place in model.places.items():
        sizes[place] = USUAL[name]
    return sizes


def _names(model: Model) -> list[str]:
    names = ["mass", *(f"{n}.{a}" for n in ("moment", "bias_force", "bias_torque") for a in "xyz")]
    for group, place in model.places.items():
        names += [f"{NAMES[group]}.{axis}" for axis in "xyz"[: place.stop - place.start]]
    return names

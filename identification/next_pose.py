"""Optimal experiment design: next attitude that most reduces the largest deviation."""

from dataclasses import dataclass

import numpy as np

from common.motion.frames import Array, R_from_quaternion, quaternion_from_R
from identification.estimates import END
from identification.least_squares import Solution
from identification.payload_model import LINEAR, NAMES, PRIOR_STD, Model, jacobian
from identification.recording import Samples

ATTITUDES = 200
LEAST_REDUCTION = 0.05  # smallest share of the variance that a new pose should remove
# Reference deviations: mass [kg], com [m], bias [N], [Nm].
LINEAR_SIZES = (0.1, 0.01, 1.0, 0.1)


@dataclass(frozen=True, slots=True)
class NextPose:
    """Attitude of the sensor in base, and its effect on the least certain parameter."""

    quaternion: tuple[float, float, float, float]
    down_in_sensor: tuple[float, float, float]
    parameter: str
    std_before: float
    std_after: float


def next_pose(solution: Solution) -> NextPose:
    """Return the best of many attitudes in all directions; the arm may only reach one near it.

    The least certain parameter has the largest standard deviation relative to its reference. A
    reading in attitude k with Jacobian J and noise S changes the covariance C to
    C - C J^T (S + J C J^T)^-1 J C. A parameter that no pose improves is skipped.
    """
    model = solution.model
    sizes = reference_sizes(model, float(solution.state.linear[0]))
    variance = np.diag(solution.covariance)
    R = _attitudes()
    no_wrench = np.zeros((ATTITUDES, 3))
    J = jacobian(solution.state, Samples(R, no_wrench, no_wrench), model)
    for order in range(1, model.drift + 1):  # the pose would be read right after the recording
        for block, of in enumerate("FM"):
            J[block, :, :, model.places[f"drift{order}_{of}"]] = END[order - 1] * np.eye(3)
    rows = J.transpose(1, 0, 2, 3).reshape(ATTITUDES, 6, model.size)
    noise = np.repeat([solution.noise.force_N, solution.noise.torque_Nm], 3) ** 2
    shared = rows @ solution.covariance
    spread = np.diag(noise) + shared @ rows.swapaxes(1, 2)
    reduction = np.einsum("kri,kri->ki", shared, np.linalg.solve(spread, shared))
    by_size = [int(i) for i in np.argsort(-variance / sizes**2)]
    improvable = [i for i in by_size if reduction[:, i].max() > LEAST_REDUCTION * variance[i]]
    least_certain = (improvable or by_size)[0]
    best = int(np.argmax(reduction[:, least_certain]))
    down = R[best].T @ solution.state.down_in_base
    return NextPose(
        quaternion=quaternion_from_R(R[best]),
        down_in_sensor=(float(down[0]), float(down[1]), float(down[2])),
        parameter=_names(model)[least_certain],
        std_before=float(np.sqrt(variance[least_certain])),
        std_after=float(
            np.sqrt(max(variance[least_certain] - reduction[best, least_certain], 0.0))
        ),
    )


def _attitudes() -> Array:
    rng = np.random.default_rng(0)  # fixed seed: the advice is reproducible
    q = rng.normal(size=(ATTITUDES, 4))
    return np.array([R_from_quaternion(row) for row in q])


def reference_sizes(model: Model, mass_kg: float) -> Array:
    """Return the reference deviation of each unknown with a payload of this mass."""
    mass, com, bias_F, bias_M = LINEAR_SIZES
    sizes = np.empty(model.size)
    sizes[:LINEAR] = [mass, *[com * mass_kg] * 3, *[bias_F] * 3, *[bias_M] * 3]
    for name, place in model.places.items():
        sizes[place] = PRIOR_STD[name]
    return sizes


def _names(model: Model) -> list[str]:
    names = ["mass", *(f"{n}.{a}" for n in ("moment", "bias_force", "bias_torque") for a in "xyz")]
    for group, place in model.places.items():
        names += [f"{NAMES[group]}.{axis}" for axis in "xyz"[: place.stop - place.start]]
    return names

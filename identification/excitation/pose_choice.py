"""Choice of attitudes: greedy D-optimal design of a plan, and the best next pose of a fit. Pure.

Each reading in attitude k adds J^T S^-1 J to the information on mass, moment, bias and, with the
priors of the fit, on tilt, mounting and gain. The next attitude of a plan is the one that increases
the determinant of the information most; the directions of gravity then spread over the sphere. The
best next pose of a fit is the one that most reduces the largest deviation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.config.payload import Payload
from common.motion.convert import vec3
from common.motion.frames import Array, R_from_quaternion, quaternion_from_R
from forcemesh.messages import Vec3
from identification.payload_fit import (
    PLACES,
    PRIOR_STD,
    SIZE,
    Directions,
    Solution,
    jacobian,
)
from identification.recording import Samples
from identification.static_poses import angle

NOISE_N, NOISE_NM = 0.02, 0.001  # of the mean of a dwell, attitude errors included
APART_RAD = np.radians(20.0)  # nearer attitudes add little information
USUAL_PAYLOAD = Payload(mass_kg=1.0, com_m=(0.0, 0.0, 0.05))
ATTITUDES = 200
LEAST_REDUCTION = 0.05  # smallest share of the variance that a new pose should remove
# Reference deviations of the plain unknowns, the moment of 1 kg: [kg], [kg m], [N], [N m].
REFERENCES = np.repeat([0.1, 0.01, 1.0, 0.1], [1, 3, 3, 3])
FIXED = 18  # unknowns of a fixed cell: all but the drift


@dataclass(frozen=True, slots=True)
class NextPose:
    """Attitude of the sensor in base, and its effect on the least certain parameter."""

    quaternion: tuple[float, float, float, float]
    down_in_sensor: Vec3
    parameter: str
    std_before: float
    std_after: float


def next_pose(solution: Solution) -> NextPose:
    """Return the best of many attitudes in all directions; the arm may only reach one near it.

    The least certain parameter has the largest standard deviation relative to its reference. A
    reading in attitude k with Jacobian J and noise S changes the covariance C to
    C - C J^T (S + J C J^T)^-1 J C. A parameter that no pose improves is skipped.
    """
    covariance = solution.covariance
    variance = np.diag(covariance)
    rng = np.random.default_rng(0)  # fixed seed: the advice is reproducible
    R = np.array([R_from_quaternion(q) for q in rng.normal(size=(ATTITUDES, 4))])
    rows = _jacobians(solution.x, R, solution.directions)
    shared = rows @ covariance
    spread = np.diag(np.repeat(solution.noise, 3) ** 2) + shared @ rows.swapaxes(1, 2)
    reduction = np.einsum("kri,kri->ki", shared, np.linalg.solve(spread, shared))
    sizes = _reference_sizes(float(solution.x[0]))
    by_size = [int(i) for i in np.argsort(-variance / sizes**2) if variance[i] > 0.0]
    improvable = [i for i in by_size if reduction[:, i].max() > LEAST_REDUCTION * variance[i]]
    least_certain = (improvable or by_size)[0]
    best = int(np.argmax(reduction[:, least_certain]))
    before = variance[least_certain]
    after = before - reduction[best, least_certain]
    return NextPose(
        quaternion=quaternion_from_R(R[best]),
        down_in_sensor=vec3(R[best].T @ solution.directions.down_in_base),
        parameter=_name(least_certain),
        std_before=float(np.sqrt(before)),
        std_after=float(np.sqrt(max(after, 0.0))),
    )


def _name(unknown: int) -> str:
    name, place = next(row for row in PLACES.items() if unknown < row[1].stop)
    return name if name == "mass" else f"{name}.{'xyz'[unknown - place.start]}"


def best_attitudes(
    R_base_sensor: Array, payload: Payload, count: int, excluded: Sequence[int] = ()
) -> list[int]:
    """Return the indices of the attitudes to add, the most informative one first.

    Fewer than `count` are returned when the others are within 20 degrees of a chosen one.

    Args:
        R_base_sensor: Attitudes to choose from. Shape (n, 3, 3).
        payload: Approximate payload of the sensor.
        count: Number of attitudes to add.
        excluded: Indices of the attitudes that are chosen already.
    """
    x = np.zeros(SIZE)
    x[:4] = payload.mass_kg * np.array([1.0, *payload.com_m])
    noise = np.repeat([NOISE_N, NOISE_NM], 3)
    J = _jacobians(x, R_base_sensor, Directions())[..., :FIXED] / noise[:, None]
    sizes = _reference_sizes(payload.mass_kg)[:FIXED]
    sizes[: len(REFERENCES)] *= 100.0  # hardly any prior information
    taken = list(excluded)
    while len(taken) < len(excluded) + count:
        is_distinct = _nearest_rad(R_base_sensor, taken) > APART_RAD
        if not is_distinct.any():
            break
        rows = J[taken].reshape(-1, FIXED)
        covariance = np.linalg.inv(np.diag(1.0 / sizes**2) + rows.T @ rows)
        gain = np.linalg.slogdet(np.eye(6) + J @ covariance @ J.swapaxes(1, 2))[1]
        taken.append(int(np.argmax(np.where(is_distinct, gain, -np.inf))))
    return taken[len(excluded) :]


def fresh_attitudes(R_base_sensor: Array, count: int, excluded: Sequence[int]) -> list[int]:
    """Return the indices of attitudes farthest from those taken and from each other."""
    taken = list(excluded)
    while len(taken) < len(excluded) + count:
        nearest_rad = _nearest_rad(R_base_sensor, taken)
        if nearest_rad.max(initial=0.0) <= APART_RAD / 2.0:
            break
        taken.append(int(np.argmax(nearest_rad)))
    return taken[len(excluded) :]


def _nearest_rad(R: Array, taken: Sequence[int]) -> Array:
    """Return the angle of each attitude to the nearest one that is taken; infinite without one."""
    angles = [angle(R[place], R) for place in taken]
    return np.asarray(np.min([np.full(len(R), np.inf), *angles], axis=0))


def _jacobians(x: Array, R_base_sensor: Array, directions: Directions) -> Array:
    """Return the derivatives of force and torque in each attitude. Shape (n, 6, 24)."""
    zeros = np.zeros((len(R_base_sensor), 3))
    J = jacobian(x, Samples(R_base_sensor, zeros, zeros), directions)
    return J.transpose(1, 0, 2, 3).reshape(-1, 6, SIZE)


def _reference_sizes(mass_kg: float) -> Array:
    """Return the reference deviation of each unknown with a payload of this mass."""
    sizes = PRIOR_STD.copy()
    sizes[: len(REFERENCES)] = REFERENCES
    sizes[PLACES["moment"]] *= mass_kg
    return sizes

"""Contact model: convex surface on a spring-damper under the flat face of a disc. Pure.

A cylinder (its axis along the plate's y axis) or a hemisphere of radius R takes the place of the
plate; its top is where the plate's upper face would be. The contact is the point of the disc that
is nearest to the centre of the sphere, or to the axis of the cylinder:

    gap = |p - c| - R,  n = (p - c) / |p - c|

(c: centre, or its projection onto the axis.) The surface gives way along n, and across it within
the Coulomb limit, with the springs and dampers of the plate: implicit midpoint rule, hence passive
(`plate.py`). It neither tilts nor twists. A line contact is spread over a tilt of about LINE_RAD:
its centre of pressure moves to the rim of a disc that is tilted further.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import SimulationError
from sim.robot.plate import DEEPEST_TOUCH_M, HALF_SIDE_M, ContactWrench, Disc, Vector3
from sim.robot.settings import FRICTION, SimSettings

Shape = Literal["cylinder", "hemisphere"]
LINE_RAD = 0.02
_E1, _E2, _UP = np.eye(3)


@dataclass(slots=True)
class SprungSurface:
    """Spring-dampers of a convex surface and their deflections; the top is the frame's origin."""

    shape: Shape
    radius_m: float
    stiffness_N_m: float  # along the normal and across it
    relaxation_s: float  # damping over stiffness
    friction: float

    travel_m: float = 0.0  # along the normal; negative is pushed in
    shear_m: Vector3 = (0.0, 0.0, 0.0)  # across it
    touched: bool = False

    @classmethod
    def of(cls, settings: SimSettings) -> "SprungSurface":
        """Return the undeflected surface of a cell. Raises SimulationError for a plane."""
        if settings.surface == "plane":
            raise SimulationError("a plane is no curved surface")
        return cls(
            settings.surface,
            settings.radius_m,
            stiffness_N_m=settings.stiffness_N_m,
            relaxation_s=settings.plate_relaxation_s,
            friction=FRICTION,
        )

    @property
    def rests(self) -> bool:
        """Whether every spring is undeflected."""
        return not self.touched and self.travel_m == 0.0 and not any(self.shear_m)

    def step(self, disc: Disc, dt_s: float) -> ContactWrench:
        """Advance by `dt_s` [s] to the given disc state; return the wrench on the disc."""
        gap_m, normal, arm = self.nearest(disc)
        if gap_m >= 0.0 and self.rests:
            return ContactWrench()
        rate = self.relaxation_s / dt_s + 0.5  # midpoint rule, as in `SprungPlate.step`
        k, kept = rate * self.stiffness_N_m, 1.0 - 1.0 / rate
        free_m = kept * self.travel_m
        reaches = self.touched or gap_m >= -DEEPEST_TOUCH_M
        normal_N = max(0.0, k * (free_m - gap_m)) if reaches and self._covers(disc, normal) else 0.0
        self.touched, self.travel_m = normal_N > 0.0, free_m - normal_N / k
        velocity = np.array(disc.velocity_m_s) + np.cross(disc.turn_rad_s, arm)
        shear_m = np.array(self.shear_m)
        pull_N = -k * ((1.0 - kept) * shear_m + dt_s * velocity)
        pull_N -= (pull_N @ normal) * normal
        size_N, limit_N = float(np.linalg.norm(pull_N)), self.friction * normal_N
        if size_N > limit_N:
            pull_N *= limit_N / size_N
        shear_m = kept * shear_m - pull_N / k
        self.shear_m = _triple(shear_m - (shear_m @ normal) * normal)
        force_N = normal_N * normal + pull_N
        return ContactWrench(_triple(force_N), _triple(np.cross(arm, force_N)), normal_N)

    def nearest(self, disc: Disc) -> tuple[float, Array, Array]:
        """Return the gap [m], the normal and the contact from the disc's centre [m]."""
        away = np.array(disc.centre_m) + self.radius_m * _UP
        e1, e2 = _face_axes(np.array(disc.back))
        if self.shape == "hemisphere":
            u, v = -float(away @ e1), -float(away @ e2)
        else:  # least squares of the distance to the axis, spread for a disc along it
            away[1] = 0.0
            A = np.array([[e1[0], e2[0]], [e1[2], e2[2]], [LINE_RAD, 0.0], [0.0, LINE_RAD]])
            b = np.array([-away[0], -away[2], 0.0, 0.0])
            u, v = np.linalg.solve(A.T @ A, A.T @ b).tolist()
        size_m = float(np.hypot(u, v))
        share = 1.0 if size_m <= disc.radius_m else disc.radius_m / size_m
        arm = share * (u * e1 + v * e2)
        place = away + arm
        if self.shape == "cylinder":
            place[1] = 0.0
        distance_m = float(np.linalg.norm(place))
        return distance_m - self.radius_m, place / distance_m, arm

    def _covers(self, disc: Disc, normal: Array) -> bool:
        """Return whether the surface extends to the contact: not beyond its base and its ends."""
        ends = self.shape == "cylinder" and abs(disc.centre_m[1]) > HALF_SIDE_M
        return bool(normal @ _UP > 0.0) and not ends


def _face_axes(back: Array) -> tuple[Array, Array]:
    """Return two unit vectors that span the face of the disc. Shapes (3,)."""
    e1 = _E1 - (back @ _E1) * back
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(back, e1)


def _triple(vector: Array) -> Vector3:
    x, y, z = vector.tolist()
    return (x, y, z)

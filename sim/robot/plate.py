"""Contact model: massless plate on spring-dampers under the flat face of a disc. Pure.

The plate deflects along its normal by u and tilts by the slopes s; both are spring-dampers
(Kelvin-Voigt). Without mass its state is quasi-static: the state of least energy among those
without penetration. With the disc's centre c and the unit vector b from the face into the tool,
in the plate's undeflected frame, the gap at the nearest point of the rim is

    gap(u, s) = c_z - u - s . c_xy - r |b_xy + b_z s|  >= 0

(`lift_off_m` is the same distance for a rigid plane). The normal force N >= 0 is the Lagrange
multiplier of this constraint; the centre of pressure is a point of the disc.

Within its plane the plate deflects under the contact by z and twists by psi. Friction holds the
disc's face to that spring up to the Coulomb limit and slips beyond it (elastoplastic bristle model;
Dupont et al., Single state elastoplastic friction models, IEEE TAC 47(5), 2002). Force and torque
share a limit ellipsoid (Howe and Cutkosky, Practical force-motion models for sliding manipulation,
IJRR 15(6), 1996); the torque's lever is half the chord of the rim through the centre of pressure:
r for a disc that lies flat, zero for a disc on its edge.

Each step is implicit: a projection on the gap constraint, then one on the ellipsoid (return
mapping). The springs follow the midpoint rule and store exactly the energy supplied; dampers and
slip dissipate for any step size. Hence the plate is passive.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from sim.robot.settings import FRICTION, SimSettings

HALF_SIDE_M = 0.08  # half the side of the plate: no contact beyond it
DEEPEST_TOUCH_M = 0.002  # a first penetration deeper than this means: the disc is below the plate
LEAST_LEVER_M = 1e-6
NEWTON_STEPS = 40
FORCE_EXACT_N = 1e-9

Vector2 = tuple[float, float]
Vector3 = tuple[float, float, float]
_ORIGIN = (0.0, 0.0, 0.0)


class Disc(NamedTuple):
    """Disc face at the end of a step, and its velocity, in the undeflected plate frame."""

    centre_m: Vector3
    back: Vector3  # unit vector from the face into the tool
    velocity_m_s: Vector3  # of the centre
    turn_rad_s: Vector3
    radius_m: float


class ContactWrench(NamedTuple):
    """Wrench of the plate on the disc, in the undeflected plate frame, about the disc's centre."""

    force_N: Vector3 = (0.0, 0.0, 0.0)
    torque_Nm: Vector3 = (0.0, 0.0, 0.0)
    normal_N: float = 0.0


@dataclass(slots=True)
class SprungPlate:
    """Spring-dampers of the plate and their deflections."""

    stiffness_N_m: float  # along the normal and within the plane
    tilt_stiffness_Nm_rad: float  # about any axis
    relaxation_s: float  # damping over stiffness, of every spring
    friction: float

    travel_m: float = 0.0  # u, deflection at the plate's centre; negative is pushed in
    slope: Vector2 = (0.0, 0.0)  # s: slope along x and y
    shear_m: Vector2 = (0.0, 0.0)  # z: within the plane, under the contact
    twist_rad: float = 0.0  # psi: about the normal, under the contact
    touched: bool = False

    @classmethod
    def of(cls, settings: SimSettings) -> "SprungPlate":
        """Return the undeflected plate of a cell."""
        return cls(
            stiffness_N_m=settings.stiffness_N_m,
            tilt_stiffness_Nm_rad=settings.plate_tilt_stiffness_Nm_rad,
            relaxation_s=settings.plate_relaxation_s,
            friction=FRICTION,
        )

    @property
    def rests(self) -> bool:
        """Whether every spring is undeflected."""
        away = (self.travel_m, self.twist_rad, *self.slope, *self.shear_m)
        return not self.touched and not any(away)

    def step(self, disc: Disc, dt_s: float) -> ContactWrench:
        """Advance by `dt_s` [s] to the given disc state; return the wrench on the disc."""
        (x, y, z), (bx, by, _) = disc.centre_m, disc.back
        if z - disc.radius_m * math.hypot(bx, by) >= 0.0 and self.rests:
            return ContactWrench()
        # Midpoint rule of the spring-dampers: force k (x1 - kept x0); `kept` is the unloaded decay.
        rate = self.relaxation_s / dt_s + 0.5
        k, k_tilt = rate * self.stiffness_N_m, rate * self.tilt_stiffness_Nm_rad
        kept = 1.0 - 1.0 / rate
        free_m, free_x, free_y = kept * self.travel_m, kept * self.slope[0], kept * self.slope[1]
        squeeze = _Squeeze(disc, k, k_tilt, free_m, (free_x, free_y))
        normal_N, arm = 0.0, _ORIGIN
        if max(abs(x), abs(y)) <= HALF_SIDE_M:
            gap_m, _, _ = squeeze.at(0.0)
            if gap_m < 0.0 and (self.touched or gap_m >= -DEEPEST_TOUCH_M):
                normal_N, arm = squeeze.solve(-k * gap_m)  # tilt can only reduce the force
        self.touched = normal_N > 0.0
        self.travel_m, give = free_m - normal_N / k, normal_N / k_tilt
        ax, ay, az = arm
        self.slope = (free_x - give * (x + ax), free_y - give * (y + ay))
        # Friction within the plane, at the centre of pressure: stick, or slip at the limit.
        (vx, vy, _), (wx, wy, wz), (zx, zy) = disc.velocity_m_s, disc.turn_rad_s, self.shear_m
        fx = -k * (zx + dt_s * (vx + wy * az - wz * ay) - kept * zx)
        fy = -k * (zy + dt_s * (vy + wz * ax - wx * az) - kept * zy)
        twist_Nm = -k_tilt * (self.twist_rad + dt_s * wz - kept * self.twist_rad)
        lever_m = math.sqrt(max(0.0, disc.radius_m**2 - ax * ax - ay * ay - az * az))
        if lever_m < LEAST_LEVER_M:
            twist_Nm, lever_m = 0.0, 1.0  # a disc on its edge transmits no twist torque
        limit_N, used_N = self.friction * normal_N, math.hypot(fx, fy, twist_Nm / lever_m)
        if used_N > limit_N:
            share = limit_N / used_N
            fx, fy, twist_Nm = share * fx, share * fy, share * twist_Nm
        self.shear_m = (kept * zx - fx / k, kept * zy - fy / k)
        self.twist_rad = kept * self.twist_rad - twist_Nm / k_tilt
        fx, fy, fz = fx - normal_N * self.slope[0], fy - normal_N * self.slope[1], normal_N
        torque = (ay * fz - az * fy, az * fx - ax * fz, ax * fy - ay * fx + twist_Nm)
        return ContactWrench((fx, fy, fz), torque, normal_N)


class _Squeeze(NamedTuple):
    """Projection on the gap constraint: one equation for the normal force, monotonic in it."""

    disc: Disc
    k: float  # of the midpoint rule [N/m]
    k_tilt: float  # [N m/rad]
    free_m: float  # deflection of the unloaded plate at the end of the step
    free_slope: Vector2

    def solve(self, most_N: float) -> tuple[float, Vector3]:
        """Return the normal force [N] and the centre of pressure from the disc's centre [m]."""
        low, high, arm_m = 0.0, most_N, _ORIGIN
        (x, y, z), (bx, by, bz) = self.disc.centre_m, self.disc.back
        normal_N = 0.0
        if abs(bz) >= 0.1:  # initial guess: the disc lies flat
            normal_N = self.k * (self.free_m - z - (bx * x + by * y) / bz)
        for _ in range(NEWTON_STEPS):
            if not low < normal_N <= high:
                normal_N = 0.5 * (low + high)
            gap_m, rises, arm_m = self.at(normal_N)
            low, high = (normal_N, high) if gap_m < 0.0 else (low, normal_N)
            step_N = gap_m / rises
            if abs(step_N) < FORCE_EXACT_N:
                break
            normal_N -= step_N
        return normal_N, arm_m

    def at(self, normal_N: float) -> tuple[float, float, Vector3]:
        """Return gap, its derivative by the force, and the centre of pressure [m, m/N, m]."""
        (x, y, z), (bx, by, bz), _, _, r = self.disc
        k, k_tilt, (free_x, free_y) = self.k, self.k_tilt, self.free_slope
        give, travel_m = normal_N / k_tilt, self.free_m - normal_N / k
        # The relative tilt is q - give bz arm. On an edge the arm is the rim's lowest point, along
        # q. If that would tilt the disc beyond flat, it lies flat with its arm within the rim.
        qx, qy = bx + bz * (free_x - give * x), by + bz * (free_y - give * y)
        q, rises = math.hypot(qx, qy), 1.0 / k
        tilt = q - give * r * bz * bz
        if tilt <= 0.0 < give:
            gap_m = z - travel_m + (bx * x + by * y) / bz
            arm_x, arm_y = qx / (give * bz), qy / (give * bz)
            return gap_m, rises, (arm_x, arm_y, -(arm_x * bx + arm_y * by) / bz)
        ex, ey = (qx / q, qy / q) if q > 0.0 else (0.0, 0.0)
        arm_x, arm_y = r * bz * ex, r * bz * ey
        sx, sy = free_x - give * (x + arm_x), free_y - give * (y + arm_y)
        gap_m = z - travel_m - sx * x - sy * y - r * tilt
        rises += ((x + arm_x) ** 2 + (y + arm_y) ** 2) / k_tilt
        if q > 0.0:
            rises -= give * r * (bz * (x * ey - y * ex)) ** 2 / (k_tilt * q)
        return gap_m, rises, (arm_x, arm_y, -r * (ex * bx + ey * by))


def lift_off_m(
    T_base_tcp: pin.SE3, *, plate_point_m: Array, plate_normal: Array, disc_radius_m: float
) -> float:
    """Return the signed distance [m] from a plane to the lowest point of a disc's rim.

    d = n . (p_tcp - p) - r |n x z|; positive: no contact, negative: penetration.

    Args:
        T_base_tcp: Centre of the disc, z along the disc's axis.
        plate_point_m: Any point of the plane at rest, in base [m]. Shape (3,).
        plate_normal: Unit normal of the plane in base, towards the disc. Shape (3,).
        disc_radius_m: Radius of the disc [m].
    """
    centre_m = float(plate_normal @ (T_base_tcp.translation - plate_point_m))
    cos_tilt = float(plate_normal @ T_base_tcp.rotation[:, 2])
    return centre_m - disc_radius_m * math.sqrt(max(0.0, 1.0 - cos_tilt * cos_tilt))


def plate_point_under(
    T_base_tcp: pin.SE3, *, plate_normal: Array, disc_radius_m: float, gap_m: float
) -> Array:
    """Return the point of a plane vertically below the TCP that leaves a gap of `gap_m`.

    The gap is measured vertically from the rim point nearest to the plane. With n_z of the
    normal, gap * n_z = lift_off, which is solved for the height of the point.

    Args:
        T_base_tcp: Centre of the disc, z along the disc's axis.
        plate_normal: Unit normal of the plane in base, upwards. Shape (3,).
        disc_radius_m: Radius of the disc [m].
        gap_m: Vertical distance at the nearest point of the rim [m].
    """
    here = T_base_tcp.translation
    rim_m = lift_off_m(
        T_base_tcp, plate_point_m=here, plate_normal=plate_normal, disc_radius_m=disc_radius_m
    )
    down_m = gap_m - rim_m / float(plate_normal[2])
    return np.array([here[0], here[1], here[2] - down_m])

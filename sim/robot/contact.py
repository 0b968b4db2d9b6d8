"""Contact geometry of a flat disc and a plane: ground truth for contact. Pure."""

import math

import numpy as np
import pinocchio as pin

from common.motion.frames import Array


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

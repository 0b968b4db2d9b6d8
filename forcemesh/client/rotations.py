"""Pose of a jog from quaternion products, so that a client needs no maths library.

`q_a_b` is the orientation of frame b in frame a as x, y, z, w; `p_a_b` the origin of b in a [m].
"""

import math

from forcemesh.messages import PoseRecord, Quaternion, Vec3

IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)
PARALLEL = 1e-9  # sine of the angle between two axes that count as parallel


def times(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the product: first b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(q: Quaternion) -> Quaternion:
    """Return the inverse of a unit quaternion."""
    x, y, z, w = q
    return (-x, -y, -z, w)


def rotate(q: Quaternion, v: Vec3) -> Vec3:
    """Return a vector rotated by a unit quaternion."""
    x, y, z, _ = times(times(q, (*v, 0.0)), inverse(q))
    return (x, y, z)


def plus(a: Vec3, b: Vec3) -> Vec3:
    """Return the sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def from_rotation_vector(rotation_rad: Vec3) -> Quaternion:
    """Return the unit quaternion of a rotation vector [rad]."""
    angle = math.hypot(*rotation_rad)
    share = 0.5 if angle < 1e-9 else math.sin(angle / 2.0) / angle
    x, y, z = rotation_rad
    return (share * x, share * y, share * z, math.cos(angle / 2.0))


def from_oat_deg(oat_deg: Vec3) -> Quaternion:
    """Return the unit quaternion of Kawasaki's O, A, T [degrees]: about z, then y, then z."""
    o, a, t = (math.radians(angle) for angle in oat_deg)
    return times(
        times(from_rotation_vector((0.0, 0.0, o)), from_rotation_vector((0.0, a, 0.0))),
        from_rotation_vector((0.0, 0.0, t)),
    )


def to_oat_deg(q: Quaternion) -> Vec3:
    """Return Kawasaki's O, A, T [degrees] of a unit quaternion, the inverse of `from_oat_deg`.

    A is within 0 to 180; where the z axes are parallel, O and T are one rotation and O is 0.
    """
    y_axis, z_axis = rotate(q, (0.0, 1.0, 0.0)), rotate(q, (0.0, 0.0, 1.0))
    x_axis = rotate(q, (1.0, 0.0, 0.0))
    level = math.hypot(z_axis[0], z_axis[1])
    a = math.atan2(level, z_axis[2])
    if level < PARALLEL:
        o, t = 0.0, math.atan2(x_axis[1], y_axis[1])
    else:
        o, t = math.atan2(z_axis[1], z_axis[0]), math.atan2(y_axis[2], -x_axis[2])
    return (math.degrees(o), math.degrees(a), math.degrees(t))


def jogged(
    flange: PoseRecord,
    tool: PoseRecord,
    shift_m: Vec3,
    turn_rad: Vec3,
    *,
    in_tool_axes: bool,
) -> PoseRecord:
    """Return the flange pose after its tool is shifted and rotated about the TCP.

    Args:
        flange: Present flange pose in base.
        tool: TCP in the flange frame.
        shift_m: Along the axes of the base, or of the tool.
        turn_rad: Rotation vector about the same axes.
        in_tool_axes: Whether those axes are the tool's.
    """
    q_base_flange = flange.orientation_xyzw
    q_base_tool = times(q_base_flange, tool.orientation_xyzw)
    p_base_tool = plus(flange.position_m, rotate(q_base_flange, tool.position_m))
    rotation = from_rotation_vector(turn_rad)
    if in_tool_axes:
        p_base_tool = plus(p_base_tool, rotate(q_base_tool, shift_m))
        q_base_tool = times(q_base_tool, rotation)
    else:
        p_base_tool = plus(p_base_tool, shift_m)
        q_base_tool = times(rotation, q_base_tool)
    q_new = times(q_base_tool, inverse(tool.orientation_xyzw))
    x, y, z = rotate(q_new, tool.position_m)
    return PoseRecord(position_m=plus(p_base_tool, (-x, -y, -z)), orientation_xyzw=q_new)

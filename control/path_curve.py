"""Curve through poses of the TCP, and the feed along it. Pure.

Straight segments with uniform rotation about one axis, and around each corner a
quadratic Bezier curve that begins and ends `blend_m` before and after it. The feed accelerates and
brakes along the arc length s with a, and is planned over all pending pieces:

    v <= feed,  v^2 <= a r (radius of a blend),  v^2 <= v_end^2 + 2 a (s_end - s)

v_end is zero at a sharp corner without a blend and at the end. A rotation counts as the travel of a
point ROTATION_RADIUS_M away, so the tool may also turn in place.

Poses that are added wait, and a few are joined in each period: one takes a tenth of a millisecond.
What has been joined ends with v_end = 0, so the tool never meets a pose that still waits.

A face that turns on its contact pushes its edge into the surface, unlike one that travels over a
convex body and turns with its normal. So the share of a rotation that the travel x does not explain

    1 - x / (ROTATION_RADIUS_M angle)

has an angular speed of its own, at most `in_place_rad_s`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, inf, sqrt
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.motion.frames import (
    Array,
    apart,
    cross,
    dot,
    interpolated,
    rotate_about_base_axes,
    rotation_between,
    scaled,
)
from forcemesh.messages import ZERO3, Vec3

ROTATION_RADIUS_M = 0.02
SHARP = 0.9  # cosine of the angle of a corner from which the path stops there
LEAST_BEND = 0.01  # sine of the angle of a corner that is blended
LEAST_PIECE_M = 1e-6  # shorter ones are left out
JOIN_S = 0.004  # of a period, for each pose that is joined in it
BLEND = np.linspace(0.0, 1.0, 65)  # parameters at which the arc length of a blend is measured
BLEND_WEIGHTS = np.column_stack(((1 - BLEND) ** 2, 2 * BLEND * (1 - BLEND), BLEND**2))


class TurnLimits(NamedTuple):
    """Highest angular speeds of a path."""

    rad_s: float
    in_place_rad_s: float

    def fastest_m_s(self, travel_m: float, angle_rad: float, length_m: float) -> float:
        """Return the highest speed along a piece that travels and turns uniformly."""
        if angle_rad == 0.0:
            return inf
        in_place = max(1.0 - travel_m / (ROTATION_RADIUS_M * angle_rad), 0.0)
        rad_s = min(self.rad_s, self.in_place_rad_s / in_place) if in_place else self.rad_s
        return rad_s * length_m / angle_rad


@dataclass(frozen=True, slots=True)
class Piece:
    """Piece of the curve: straight, or a blend about a corner."""

    T_from: pin.SE3
    T_to: pin.SE3
    turn_rad: Array  # from one to the other, base axes. Shape (3,)
    length_m: float
    fastest_m_s: float  # without the feed
    ends: tuple[Vec3, Vec3]  # directions of travel there, zero for a rotation in place
    corner_m: Array | None = None  # of a blend. Shape (3,)
    travelled_m: Array | None = None  # arc length after each part of a blend

    def at(self, s_m: float) -> pin.SE3:
        """Return the pose at an arc length from its beginning."""
        share = s_m / self.length_m
        R = rotate_about_base_axes(self.T_from.rotation, share * self.turn_rad)
        a, b = self.T_from.translation, self.T_to.translation
        if self.corner_m is None:
            return pin.SE3(R, a + share * (b - a))
        t = self._parameter(s_m)
        return pin.SE3(R, (1 - t) ** 2 * a + 2 * t * (1 - t) * self.corner_m + t**2 * b)

    def tangent(self, s_m: float) -> Array:
        """Return the direction of travel, zero for a rotation in place. Shape (3,)."""
        if self.corner_m is None:
            return np.array(self.ends[0])
        t, a, b = self._parameter(s_m), self.T_from.translation, self.T_to.translation
        return np.array(_direction((1 - t) * (self.corner_m - a) + t * (b - self.corner_m)))

    def _parameter(self, s_m: float) -> float:
        assert self.travelled_m is not None  # noqa: S101 - a blend has it
        return float(np.interp(s_m, self.travelled_m, BLEND))


class WaitingPose(NamedTuple):
    """Pose that is not joined to the curve yet."""

    T_to: pin.SE3
    length_m: float  # of the segment that ends there
    blend_m: float


@dataclass(frozen=True, slots=True)
class PathCurve:
    """Pending pieces of a curve, and the speed along it."""

    T_joined: pin.SE3  # end of the pieces
    feed_m_s: float
    accel_m_s2: float
    turns: TurnLimits
    pieces: tuple[Piece, ...] = ()
    ends_m_s: tuple[float, ...] = ()  # highest speed at the end of each piece
    beyond_m: tuple[float, ...] = ()  # length after each piece
    waiting: tuple[WaitingPose, ...] = ()
    last_m: float = 0.0  # length of the last segment, with its part in a blend
    done_m: float = 0.0  # within the first piece
    now_m_s: float = 0.0

    @property
    def left_m(self) -> float:
        """Length to the end."""
        waiting_m = sum(pose.length_m for pose in self.waiting)
        if not self.pieces:
            return waiting_m
        return self.pieces[0].length_m - self.done_m + self.beyond_m[0] + waiting_m

    @property
    def pending(self) -> int:
        """Number of pieces and poses that are still to be followed."""
        return len(self.pieces) + len(self.waiting)

    @property
    def T_end(self) -> pin.SE3:
        """Last pose."""
        return self.waiting[-1].T_to if self.waiting else self.T_joined

    @property
    def T_reference(self) -> pin.SE3:
        """Pose on the curve that has been reached."""
        return self.pieces[0].at(self.done_m) if self.pieces else self.T_joined

    @property
    def tangent(self) -> Array:
        """Direction of travel, zero for a rotation in place and at the end. Shape (3,)."""
        return self.pieces[0].tangent(self.done_m) if self.pieces else np.zeros(3)

    def extended(self, poses: Sequence[pin.SE3], blend_m: float) -> "PathCurve":
        """Return the curve with more poses at its end."""
        waiting, T_last = list(self.waiting), self.T_end
        for T_to in poses:
            travel_m, angle_rad = apart(T_last, T_to)
            length_m = max(travel_m, ROTATION_RADIUS_M * angle_rad)
            if length_m >= LEAST_PIECE_M:
                waiting.append(WaitingPose(T_to, length_m, blend_m))
                T_last = T_to
        return replace(self, waiting=tuple(waiting))

    def joined(self) -> "PathCurve":
        """Return the curve with its next waiting pose joined."""
        if not self.waiting:
            return self
        T_to, _, blend_m = self.waiting[0]
        straight = _straight(self.T_joined, T_to, self.turns)
        pieces = [*self.pieces[:-1], straight]
        if self.pieces:
            last, most_m = self.pieces[-1], min(blend_m, 0.5 * self.last_m, 0.5 * straight.length_m)
            if len(self.pieces) == 1:  # the corner may be near already
                most_m = min(most_m, last.length_m - self.done_m)
            pieces[-1:] = _joined(last, straight, most_m, self)
        ends_m_s, beyond_m = _end_speeds(pieces, self.accel_m_s2)
        return replace(
            self, T_joined=T_to, waiting=self.waiting[1:], last_m=straight.length_m,
            pieces=tuple(pieces), ends_m_s=ends_m_s, beyond_m=beyond_m,
        )  # fmt: skip

    def advanced(self, dt_s: float, *, share: float, most_m: float) -> "PathCurve":
        """Return the curve after a period.

        Args:
            dt_s: Length of the period.
            share: Of the feed, which is reached with the acceleration of the curve.
            most_m: Longest travel of the period.
        """
        curve = self
        for _ in range(max(1, int(dt_s / JOIN_S))):
            curve = curve.joined()
        if not curve.pieces:
            return replace(curve, now_m_s=0.0)
        accel_m_s2, first = curve.accel_m_s2, curve.pieces[0]
        ahead_m = first.length_m - curve.done_m
        braking_m_s = sqrt(curve.ends_m_s[0] ** 2 + 2.0 * accel_m_s2 * ahead_m)
        geometry_m_s = min(first.fastest_m_s, braking_m_s)
        change_m_s = accel_m_s2 * dt_s
        feed_m_s = min(curve.feed_m_s * share, curve.now_m_s + change_m_s)
        speed_m_s = min(geometry_m_s, max(feed_m_s, curve.now_m_s - change_m_s))
        done_m, passed = curve.done_m + min(speed_m_s * dt_s, most_m), 0
        while passed < len(curve.pieces) and done_m >= curve.pieces[passed].length_m:
            done_m -= curve.pieces[passed].length_m
            passed += 1
        return replace(
            curve,
            pieces=curve.pieces[passed:],
            ends_m_s=curve.ends_m_s[passed:],
            beyond_m=curve.beyond_m[passed:],
            done_m=done_m,
            now_m_s=min(speed_m_s, most_m / dt_s),
        )


def _straight(T_from: pin.SE3, T_to: pin.SE3, turns: TurnLimits) -> Piece:
    turn_rad = rotation_between(T_from.rotation, T_to.rotation)
    travel_m, angle_rad = hypot(*T_to.translation - T_from.translation), hypot(*turn_rad)
    length_m = max(travel_m, ROTATION_RADIUS_M * angle_rad)
    fastest_m_s = turns.fastest_m_s(travel_m, angle_rad, length_m)
    along = _direction(T_to.translation - T_from.translation)
    return Piece(T_from, T_to, turn_rad, length_m, fastest_m_s, (along, along))


def _direction(along_m: Array) -> Vec3:
    """Return the unit vector, zero for one that is too short."""
    size_m, (x, y, z) = hypot(*along_m), along_m.tolist()
    return scaled((x, y, z), 1.0 / size_m) if size_m > LEAST_PIECE_M else ZERO3


def _joined(before: Piece, after: Piece, blend_m: float, curve: PathCurve) -> list[Piece]:
    """Return two straight pieces with a blend about their corner, where there is one."""
    bend = hypot(*cross(before.ends[1], after.ends[0]))
    if blend_m < LEAST_PIECE_M or bend < LEAST_BEND:  # straight on, or back
        return [before, after]
    T_in = interpolated(before.T_from, before.T_to, 1.0 - blend_m / before.length_m)
    T_out = interpolated(after.T_from, after.T_to, blend_m / after.length_m)
    straights = [
        _straight(before.T_from, T_in, curve.turns),
        _straight(T_out, after.T_to, curve.turns),
    ]
    blend = _blend(T_in, before.T_to.translation, T_out, curve)
    pieces = [straights[0], blend, straights[1]]
    return [piece for piece in pieces if piece.length_m > LEAST_PIECE_M]


def _blend(T_from: pin.SE3, corner_m: Array, T_to: pin.SE3, curve: PathCurve) -> Piece:
    """Return a blend; its curvature is largest in the middle, for both legs are equally long."""
    a, b = T_from.translation, T_to.translation
    places = BLEND_WEIGHTS @ np.array([a, corner_m, b])
    parts_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    travelled_m = np.concatenate(([0.0], np.cumsum(parts_m)))
    turn_rad = rotation_between(T_from.rotation, T_to.rotation)
    length_m, angle_rad = float(travelled_m[-1]), hypot(*turn_rad)
    chord_m, bend_m = b - a, 2.0 * (a - 2.0 * corner_m + b)
    bent = hypot(*cross(chord_m.tolist(), bend_m.tolist()))
    curvature = bent / max(hypot(*chord_m) ** 3, LEAST_PIECE_M**3)
    turning_m_s = curve.turns.fastest_m_s(length_m, angle_rad, length_m)
    fastest_m_s = min(sqrt(curve.accel_m_s2 / curvature), turning_m_s)
    ends = _direction(corner_m - a), _direction(b - corner_m)
    return Piece(T_from, T_to, turn_rad, length_m, fastest_m_s, ends, corner_m, travelled_m)


def _end_speeds(
    pieces: Sequence[Piece], accel_m_s2: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the highest speed at the end of each piece, and the length after it."""
    ends_m_s, beyond_m = [0.0], [0.0]
    for later, piece in pairwise(reversed(pieces)):  # from the end on
        turns = dot(piece.ends[1], later.ends[0]) < SHARP
        through_m_s = sqrt(ends_m_s[-1] ** 2 + 2.0 * accel_m_s2 * later.length_m)
        slower_m_s = min(piece.fastest_m_s, later.fastest_m_s, through_m_s)
        ends_m_s.append(0.0 if turns else slower_m_s)
        beyond_m.append(beyond_m[-1] + later.length_m)
    count = len(pieces)
    return tuple(reversed(ends_m_s[:count])), tuple(reversed(beyond_m[:count]))

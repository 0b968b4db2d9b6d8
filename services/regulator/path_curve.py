"""Curve through poses of the TCP, and the feed along it. Pure.

Straight segments with uniform rotation about one axis, and around each corner a
quadratic Bezier curve that begins and ends `blend_m` before and after it. The feed accelerates and
brakes along the arc length s with a, and is planned over all pending pieces:

    v <= feed,  v^2 <= a r (radius of a blend),  v^2 <= v_end^2 + 2 a (s_end - s)

v_end is zero at a sharp corner without a blend and at the end. A rotation counts as the travel of a
point ROTATION_RADIUS_M away, so the tool may also turn in place.

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

from common.motion.frames import Array, interpolated, rotate_about_base_axes, rotation_between
from services.regulator.tcp_path import SHARP

ROTATION_RADIUS_M = 0.02
LEAST_BEND = 0.01  # sine of the angle of a corner that is blended
LEAST_PIECE_M = 1e-6  # shorter ones are left out
BLEND = np.linspace(0.0, 1.0, 65)  # parameters at which the arc length of a blend is measured


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
        a, b = self.T_from.translation, self.T_to.translation
        along = b - a
        if self.corner_m is not None:
            t = self._parameter(s_m)
            along = (1 - t) * (self.corner_m - a) + t * (b - self.corner_m)
        size_m = hypot(*along)
        return along / size_m if size_m > LEAST_PIECE_M else np.zeros(3)

    def _parameter(self, s_m: float) -> float:
        assert self.travelled_m is not None  # noqa: S101 - a blend has it
        return float(np.interp(s_m, self.travelled_m, BLEND))


@dataclass(frozen=True, slots=True)
class PathCurve:
    """Pending pieces of a curve, and the speed along it."""

    T_end: pin.SE3
    feed_m_s: float
    accel_m_s2: float
    turns: TurnLimits
    pieces: tuple[Piece, ...] = ()
    ends_m_s: tuple[float, ...] = ()  # highest speed at the end of each piece
    beyond_m: tuple[float, ...] = ()  # length after each piece
    last_m: float = 0.0  # length of the last segment, with its part in a blend
    done_m: float = 0.0  # within the first piece
    now_m_s: float = 0.0

    @property
    def left_m(self) -> float:
        """Length to the end."""
        if not self.pieces:
            return 0.0
        return self.pieces[0].length_m - self.done_m + self.beyond_m[0]

    @property
    def T_reference(self) -> pin.SE3:
        """Pose on the curve that has been reached."""
        return self.pieces[0].at(self.done_m) if self.pieces else self.T_end

    @property
    def tangent(self) -> Array:
        """Direction of travel, zero for a rotation in place and at the end. Shape (3,)."""
        return self.pieces[0].tangent(self.done_m) if self.pieces else np.zeros(3)

    def extended(self, poses: Sequence[pin.SE3], blend_m: float) -> "PathCurve":
        """Return the curve with more poses at its end."""
        pieces, T_last, last_m = list(self.pieces), self.T_end, self.last_m
        for T_to in poses:
            straight = _straight(T_last, T_to, self.turns)
            if straight.length_m < LEAST_PIECE_M:
                continue
            if pieces:
                most_m = min(blend_m, 0.5 * last_m, 0.5 * straight.length_m)
                if len(pieces) == 1:  # the corner may be near already
                    most_m = min(most_m, pieces[0].length_m - self.done_m)
                pieces[-1:] = _joined(pieces[-1], straight, most_m, self)
            else:
                pieces = [straight]
            T_last, last_m = T_to, straight.length_m
        ends_m_s, beyond_m = _end_speeds(pieces, self.accel_m_s2)
        return replace(
            self, T_end=T_last, last_m=last_m,
            pieces=tuple(pieces), ends_m_s=ends_m_s, beyond_m=beyond_m,
        )  # fmt: skip

    def advanced(self, dt_s: float, *, share: float, most_m: float) -> "PathCurve":
        """Return the curve after a period.

        Args:
            dt_s: Length of the period.
            share: Of the feed, which is reached with the acceleration of the curve.
            most_m: Longest travel of the period.
        """
        if not self.pieces:
            return replace(self, now_m_s=0.0)
        accel_m_s2, first = self.accel_m_s2, self.pieces[0]
        ahead_m = first.length_m - self.done_m
        braking_m_s = sqrt(self.ends_m_s[0] ** 2 + 2.0 * accel_m_s2 * ahead_m)
        geometry_m_s = min(first.fastest_m_s, braking_m_s)
        change_m_s = accel_m_s2 * dt_s
        feed_m_s = min(self.feed_m_s * share, self.now_m_s + change_m_s)
        speed_m_s = min(geometry_m_s, max(feed_m_s, self.now_m_s - change_m_s))
        done_m, passed = self.done_m + min(speed_m_s * dt_s, most_m), 0
        while passed < len(self.pieces) and done_m >= self.pieces[passed].length_m:
            done_m -= self.pieces[passed].length_m
            passed += 1
        return replace(
            self,
            pieces=self.pieces[passed:],
            ends_m_s=self.ends_m_s[passed:],
            beyond_m=self.beyond_m[passed:],
            done_m=done_m,
            now_m_s=min(speed_m_s, most_m / dt_s),
        )


def _straight(T_from: pin.SE3, T_to: pin.SE3, turns: TurnLimits) -> Piece:
    turn_rad = rotation_between(T_from.rotation, T_to.rotation)
    travel_m, angle_rad = hypot(*T_to.translation - T_from.translation), hypot(*turn_rad)
    length_m = max(travel_m, ROTATION_RADIUS_M * angle_rad)
    fastest_m_s = turns.fastest_m_s(travel_m, angle_rad, length_m)
    return Piece(T_from, T_to, turn_rad, length_m, fastest_m_s)


def _joined(before: Piece, after: Piece, blend_m: float, curve: PathCurve) -> list[Piece]:
    """Return two straight pieces with a blend about their corner, where there is one."""
    a, b = before.tangent(0.0), after.tangent(0.0)
    if blend_m < LEAST_PIECE_M or hypot(*np.cross(a, b)) < LEAST_BEND:  # straight on, or back
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
    t = BLEND[:, np.newaxis]
    places = (1 - t) ** 2 * a + 2 * t * (1 - t) * corner_m + t**2 * b
    parts_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    travelled_m = np.concatenate(([0.0], np.cumsum(parts_m)))
    turn_rad = rotation_between(T_from.rotation, T_to.rotation)
    length_m, angle_rad = float(travelled_m[-1]), hypot(*turn_rad)
    chord_m, bend_m = b - a, 2.0 * (a - 2.0 * corner_m + b)
    curvature = hypot(*np.cross(chord_m, bend_m)) / max(hypot(*chord_m) ** 3, LEAST_PIECE_M**3)
    turning_m_s = curve.turns.fastest_m_s(length_m, angle_rad, length_m)
    fastest_m_s = min(sqrt(curve.accel_m_s2 / curvature), turning_m_s)
    return Piece(T_from, T_to, turn_rad, length_m, fastest_m_s, corner_m, travelled_m)


def _end_speeds(
    pieces: Sequence[Piece], accel_m_s2: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the highest speed at the end of each piece, and the length after it."""
    ends_m_s, beyond_m = [0.0], [0.0]
    for later, piece in pairwise(reversed(pieces)):  # from the end on
        turns = piece.tangent(piece.length_m) @ later.tangent(0.0) < SHARP
        through_m_s = sqrt(ends_m_s[-1] ** 2 + 2.0 * accel_m_s2 * later.length_m)
        slower_m_s = min(piece.fastest_m_s, later.fastest_m_s, through_m_s)
        ends_m_s.append(0.0 if turns else slower_m_s)
        beyond_m.append(beyond_m[-1] + later.length_m)
    count = len(pieces)
    return tuple(reversed(ends_m_s[:count])), tuple(reversed(beyond_m[:count]))

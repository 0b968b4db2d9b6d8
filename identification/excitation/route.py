"""Paths of a calibration: between poses directly, or by the hub where that is blocked. Pure."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from common.motion.frames import Array
from common.motion.paths import JointPath
from identification.excitation.boundaries import Boundaries

AT_REACHED_RAD = np.radians(0.3)
ROUNDS = 20


@dataclass(frozen=True, slots=True)
class JointRoute:
    """Allowed regions, start and hub of the paths.

    `boundaries` applies between the poses, `near_start` between the start and the hub.
    """

    boundaries: Boundaries
    near_start: Boundaries
    q_start: Array
    hub: Array

    @property
    def lift_m(self) -> float:
        """Height of the hub above the start [m]; the tool does not rotate between them."""
        arm = self.boundaries.arm
        hub, start = arm.flange_pose(self.hub), arm.flange_pose(self.q_start)
        return float(hub.translation[2] - start.translation[2])

    def goals(self, q_from: Array, q_to: Array) -> list[Array]:
        """Return the joint goals [rad] to a pose; the last one is the pose itself."""
        if not self.boundaries.path_violation(q_from, q_to):
            return [q_to]
        return [self.hub, q_to]

    def goals_to_hub(self, q_from: Array) -> list[Array]:
        """Return the joint goals from the start to the hub."""
        return [] if _are_same(q_from, self.hub) else [self.hub]

    def goals_to_start(self, q_from: Array) -> list[Array]:
        """Return the joint goals back to the start."""
        if _are_same(q_from, self.q_start):
            return []
        return [*self.goals_to_hub(q_from), self.q_start]

    def length_m(self, q_from: Array, q_to: Array) -> float:
        """Return the travel of the fastest point of the arm between two poses [m]."""
        stops = [q_from, *self.goals(q_from, q_to)]
        pairs = pairwise(stops)
        return sum(JointPath(self.boundaries.arm, a, b).extent_m for a, b in pairs)


def shortest_order(route: JointRoute, q: Array, places: list[int], q_from: Array) -> list[int]:
    """Return the poses in an order of short travel: nearest neighbour, then 2-opt.

    Args:
        route: Paths between the poses.
        q: Joint angles [rad]. Shape (n, 6).
        places: Indices of the poses to visit.
        q_from: Start of the visit [rad]. Shape (6,).
    """
    stops = [q_from, *(q[place] for place in places)]
    n = len(stops)
    distance_m = np.zeros((n, n))
    for i in range(n):
        for j in range(i):
            distance_m[i, j] = distance_m[j, i] = route.length_m(stops[i], stops[j])
    order, remaining = [0], list(range(1, n))
    while remaining:
        nearest = min(remaining, key=lambda k: (distance_m[order[-1], k], k))
        order.append(nearest)
        remaining.remove(nearest)
    for _ in range(ROUNDS):
        shorter = _with_reversed_section(order, distance_m)
        if shorter == order:
            break
        order = shorter
    return [places[k - 1] for k in order[1:]]


def _with_reversed_section(order: list[int], distance_m: Array) -> list[int]:
    """Return the order with one section reversed where that is shorter, else unchanged (2-opt)."""
    for i in range(1, len(order) - 1):
        for j in range(i + 1, len(order)):
            turned = order[:i] + order[i : j + 1][::-1] + order[j + 1 :]
            if _length(turned, distance_m) < _length(order, distance_m) - 1e-9:
                return turned
    return order


def _length(order: list[int], distance_m: Array) -> float:
    return float(distance_m[order[:-1], order[1:]].sum())


def _are_same(q: Array, q_other: Array) -> bool:
    return bool(np.abs(q - q_other).max() <= AT_REACHED_RAD)

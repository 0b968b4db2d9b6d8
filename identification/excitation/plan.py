"""Plan of a calibration: its poses and the paths between them, for this cell and arm. Pure.

Flange, sensor and TCP stay inside box, walls, tether and joint limits, and above the lowest point
of the start. Other obstacles are unknown; the user must confirm that the box is free.

The tool is first lifted from the start to a hub, from which every pose can be reached. Candidate
poses turn the wrist far and the arm little. The plan is reproducible: the same start gives the same
plan.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, pairwise
from math import degrees

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.payload import Payload
from common.motion.frames import Array, apart
from common.motion.kinematics import ArmKinematics
from common.motion.limits import Limits
from common.motion.paths import JointPath
from identification.errors import CalibrationError
from identification.excitation.pose_choice import (
    USUAL_PAYLOAD,
    best_attitudes,
    fresh_attitudes,
)
from identification.identify import POOR_CONDITIONING
from identification.payload_fit import DOWN, conditioning
from identification.static_poses import WORST_CONDITIONING

LEAST_PLANNED_POSES = 6
AT_REACHED_RAD = np.radians(0.3)
ROUNDS = 20  # of shortening the order of the visit
LIFTS_M = (0.1, 0.08, 0.06, 0.04, 0.02, 0.0)
CANDIDATES = 6000
MOST_CANDIDATES = 400  # feasible ones; more would add little information
ARM_TURN_RAD = np.radians([25.0, 35.0, 35.0])  # of joints 1 to 3, at most
FOLDED_RAD = np.radians(105.0)  # beyond this, the last joint but one folds the tool back
LEAST_SINGULAR_VALUE = 0.05  # of the Jacobian (m, rad): away from singular poses
ADVICE = (
    "start with the tool pointing down and more free space around it (in the middle of the box, "
    "half a metre in front of the arm, joint 5 bent), increase limits.workspace_* or --turn, or "
    "use --manual"
)
STEP_M = 0.02  # largest travel of any point between two samples of a path
MARGIN_M = 0.012  # keeps the path between two samples inside as well
JOINT_MARGIN_RAD = np.radians(3.0)
TURN_MARGIN_RAD = np.radians(2.0)
POINTS = ("flange", "sensor", "TCP")


@dataclass(frozen=True, slots=True)
class Boundaries:
    """Box and walls of the cell, with tether and floor relative to the start.

    `points_in_flange_m` has shape (3, 3): origins of flange, sensor and TCP. `floor_m` is the
    least height of any of them: obstacles below the tool are unknown.
    """

    arm: ArmKinematics
    limits: Limits
    points_in_flange_m: Array
    T_start: pin.SE3  # flange in base where the arm was armed
    floor_m: float

    @classmethod
    def of(cls, cell: CellConfig, arm: ArmKinematics, q_start: Array) -> "Boundaries":
        """Return the fence of a cell; its floor is the lowest point at q_start [rad]."""
        sensor_m, tcp_m = cell.sensor.T_flange_sensor.position_m, cell.tool.T_flange_tcp.position_m
        points = np.array([(0.0, 0.0, 0.0), sensor_m, tcp_m])
        T_start = arm.flange_pose(q_start)
        boundaries = cls(arm, Limits.of(cell), points, T_start, floor_m=-np.inf)
        return replace(boundaries, floor_m=float(boundaries.points(T_start)[:, 2].min()))

    def points(self, T_flange: pin.SE3) -> Array:
        """Return flange, sensor and TCP in base [m] for a flange pose. Shape (3, 3)."""
        return np.asarray(T_flange.translation + self.points_in_flange_m @ T_flange.rotation.T)

    def violation(self, q: Array, margin_m: float = MARGIN_M) -> str:
        """Return why joint angles q [rad] are not allowed; empty when they are."""
        low = (self.limits.joint_min_rad + JOINT_MARGIN_RAD).tolist()
        high = (self.limits.joint_max_rad - JOINT_MARGIN_RAD).tolist()
        for joint, angle in enumerate(q.tolist()):
            if not low[joint] <= angle <= high[joint]:
                return f"joint {joint + 1} would be at {degrees(angle):.0f} degrees, near its limit"
        T = self.arm.flange_pose(q)
        if found := self._point_violation(self.points(T), margin_m):
            return found
        moved_m, turned_rad = apart(self.T_start, T)
        if moved_m > self.limits.tether_m - margin_m:
            return "the flange would move farther than limits.tether_m from here"
        if turned_rad > self.limits.tether_rad - TURN_MARGIN_RAD:
            return "the flange would turn farther than limits.tether_deg from here"
        return ""

    def path_violation(self, q_from: Array, q_to: Array, margin_m: float = MARGIN_M) -> str:
        """Return why the straight joint-space path is not allowed; empty when it is."""
        change_rad = q_to - q_from
        tool_m = float(np.linalg.norm(self.points_in_flange_m, axis=1).max())
        farthest_m = np.abs(change_rad) @ (self.arm.levers_m + tool_m)  # that any point may move
        count = max(1, int(np.ceil(farthest_m / STEP_M)))
        for k in range(count + 1):
            if found := self.violation(q_from + (k / count) * change_rad, margin_m):
                return found
        return ""

    def _point_violation(self, points: Array, margin_m: float) -> str:
        limits, places = self.limits, points.tolist()
        # Plain floats: half the time of an array for nine values; a plan calls this 15 000 times.
        low = (limits.workspace_min_m + margin_m).tolist()
        high = (limits.workspace_max_m - margin_m).tolist()
        for point, place in zip(POINTS, places, strict=True):
            for axis, value_m in enumerate(place):
                if value_m < low[axis] or value_m > high[axis]:
                    return (
                        f"the {point} would be at {'xyz'[axis]} = {1e3 * value_m:.0f} mm, outside"
                        " the workspace box or too near to its wall"
                    )
        for number, plane in enumerate(limits.planes, start=1):
            inside_m = (points - plane.point_m) @ plane.normal
            if inside_m.min() < margin_m:
                point = POINTS[int(inside_m.argmin())]
                return f"the {point} would be behind or near plane {number}"
        lowest = min(range(len(places)), key=lambda point: places[point][2])
        if places[lowest][2] < self.floor_m:
            return f"the {POINTS[lowest]} would be lower than the tool is now"
        return ""


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


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """Options of the plan."""

    poses: int = 10
    verify_poses: int = 4
    turn_rad: float = float(np.radians(120.0))  # largest rotation of joints 4 to 6 from the start
    speed_m_s: float = 0.1  # of the moves
    dwell_s: float = 0.5  # averaging time at a pose


@dataclass(frozen=True, slots=True)
class CalibrationPlan:
    """Joint goals [rad], each of shape (n,), in the order of the visit.

    `q` has one row for each reachable pose, `R_base_sensor` its attitude in a level base; `fit` and
    `verify` are indices into it.
    """

    options: PlanOptions
    route: JointRoute
    payload: Payload
    q: Array
    R_base_sensor: Array
    fit: tuple[int, ...]
    verify: tuple[int, ...]
    conditioning: float
    warnings: tuple[str, ...] = ()
    refused: tuple[int, ...] = ()

    def without(self, place: int) -> "CalibrationPlan":
        """Return the plan with a refused pose replaced by the next best one, at the end.

        Raises CalibrationError when too few poses remain.
        """
        refused = (*self.refused, place)
        fit = tuple(p for p in self.fit if p != place)
        verify = tuple(p for p in self.verify if p != place)
        # Refused poses count as taken, so that no pose near them is tried again.
        excluded = (*fit, *verify, *refused)
        if len(fit) < len(self.fit):
            fit += tuple(best_attitudes(self.R_base_sensor, self.payload, 1, excluded))
        else:
            verify += tuple(fresh_attitudes(self.R_base_sensor, 1, excluded))
        if len(fit) < LEAST_PLANNED_POSES:
            raise CalibrationError(
                f"only {len(fit)} poses remain, at least {LEAST_PLANNED_POSES} are needed: {ADVICE}"
            )
        return replace(self, fit=fit, verify=verify, refused=refused)


def level_base(down_in_base: Sequence[float] | Array) -> Array:
    """Return R_level_base: a base turned so that the nominal gravity points along its -z."""
    down = np.asarray(down_in_base, dtype=np.float64)
    return np.asarray(pin.Quaternion.FromTwoVectors(down, DOWN).matrix())


def make_plan(
    cell: CellConfig, arm: ArmKinematics, q_start: Array, options: PlanOptions
) -> CalibrationPlan:
    """Plan a calibration from joint angles q_start [rad].

    Raises CalibrationError, with the remedy, when there is no good plan.
    """
    boundaries = Boundaries.of(cell, arm, q_start)
    if violation := boundaries.violation(q_start, margin_m=0.0):
        raise CalibrationError(f"no plan is possible from the present pose: {violation}; {ADVICE}")
    hub, lift_m = _hub(boundaries, q_start)
    inner = replace(boundaries, floor_m=boundaries.floor_m + 0.5 * lift_m)
    if violation := inner.violation(hub):
        raise CalibrationError(f"no room to rotate the tool: {violation}; {ADVICE}")
    q = _candidates(inner, hub, options.turn_rad)
    R_base_flange = np.array([arm.flange_pose(row).rotation for row in q]).reshape(-1, 3, 3)
    R_level_flange = level_base(cell.gravity_direction_in_base) @ R_base_flange
    R = R_level_flange @ cell.sensor.T_flange_sensor.pose.rotation
    payload = cell.payload if cell.payload.mass_kg > 0.05 else USUAL_PAYLOAD
    fit = best_attitudes(R, payload, options.poses)
    if len(fit) < LEAST_PLANNED_POSES:
        raise CalibrationError(
            f"only {len(fit)} distinct poses are possible inside the box, at least "
            f"{LEAST_PLANNED_POSES} are needed: {ADVICE}"
        )
    verify = fresh_attitudes(R, options.verify_poses, fit)
    found = conditioning(R[fit], DOWN)
    route = JointRoute(inner, boundaries, q_start, hub)
    fit_order = _shortest_order(route, q, fit, hub)
    return CalibrationPlan(
        options,
        route,
        payload,
        q,
        R,
        fit_order,
        _shortest_order(route, q, verify, q[fit_order[-1]]),
        conditioning=found,
        warnings=_warnings(len(fit), len(verify), options, found),
    )


def _warnings(
    fit: int, verify: int, options: PlanOptions, condition_number: float
) -> tuple[str, ...]:
    """Return the warnings of a plan. Raises CalibrationError when it is too poor."""
    if condition_number > WORST_CONDITIONING:
        raise CalibrationError(
            f"the poses inside the box differ too little (condition number {condition_number:.0f}, "
            f"limit {WORST_CONDITIONING:.0f}): {ADVICE}"
        )
    warnings = []
    if fit < options.poses:
        warnings.append(f"only {fit} of {options.poses} poses are possible inside the box")
    if verify < options.verify_poses:
        warnings.append(f"only {verify} of {options.verify_poses} poses to verify are possible")
    if condition_number > POOR_CONDITIONING:
        text = f"condition number {condition_number:.0f} is poor, above {POOR_CONDITIONING:.0f}"
        warnings.append(f"{text}: {ADVICE}")
    return tuple(warnings)


def _hub(boundaries: Boundaries, q_start: Array) -> tuple[Array, float]:
    """Return joint angles [rad] straight above the start, as high as possible, and the lift [m]."""
    T_start = boundaries.arm.flange_pose(q_start)
    for lift_m in LIFTS_M:
        lifted = pin.SE3(T_start.rotation, T_start.translation + np.array([0.0, 0.0, lift_m]))
        q = boundaries.arm.solve(lifted, q_start, jump_rad=0.8).q
        # The joint-space path deviates slightly sideways from the straight line.
        if q is None or boundaries.violation(q):
            continue
        if not boundaries.path_violation(q_start, q, 0.0):
            return q, lift_m
    return q_start, 0.0


def _candidates(boundaries: Boundaries, hub: Array, turn_rad: float) -> Array:
    """Return joint angles with a free path from the hub and back. One row for each."""
    rng = np.random.default_rng(0)  # reproducible plan
    arm = boundaries.arm
    elbow_rad = ARM_TURN_RAD[2:].repeat(arm.joints - 6)  # of a seventh joint
    largest_rad = np.array([*ARM_TURN_RAD, *elbow_rad, *[turn_rad] * 3])
    offsets = rng.uniform(-1.0, 1.0, (CANDIDATES, len(largest_rad))) * largest_rad
    offsets[::4, :-3] = 0.0  # a quarter of the candidates turn the wrist only
    folded_rad = max(float(FOLDED_RAD), abs(float(hub[-2])))
    feasible = (
        q
        for q in hub + offsets
        if abs(q[-2]) <= folded_rad
        and not boundaries.violation(q)
        and np.linalg.svd(arm.jacobian(q), compute_uv=False)[-1] >= LEAST_SINGULAR_VALUE
        and not boundaries.path_violation(hub, q)
    )
    return np.array(list(islice(feasible, MOST_CANDIDATES))).reshape(-1, len(hub))


def spread_deg(plan: CalibrationPlan) -> float:
    """Return the largest angle between gravity directions in sensor axes, of the fit [degrees]."""
    down = -plan.R_base_sensor[list(plan.fit), 2, :]
    return degrees(float(np.arccos(np.clip((down @ down.T).min(), -1.0, 1.0))))


def _shortest_order(
    route: JointRoute, q: Array, places: list[int], q_from: Array
) -> tuple[int, ...]:
    """Return some poses of q in an order of short travel: nearest neighbour, then 2-opt."""
    stops = [q_from, *(q[place] for place in places)]
    n = len(stops)
    distance_m = np.zeros((n, n))
    for i, j in combinations(range(n), 2):
        distance_m[i, j] = distance_m[j, i] = route.length_m(stops[j], stops[i])
    order, remaining = [0], list(range(1, n))
    while remaining:
        order.append(min(remaining, key=lambda k: distance_m[order[-1], k]))
        remaining.remove(order[-1])

    def length_m(order: list[int]) -> float:
        return float(distance_m[order[:-1], order[1:]].sum())

    for _ in range(ROUNDS):
        with_reversed_section = (
            order[:i] + order[i : j + 1][::-1] + order[j + 1 :]
            for i, j in combinations(range(1, n), 2)
        )
        least_m = length_m(order) - 1e-9
        shorter = next((other for other in with_reversed_section if length_m(other) < least_m), [])
        if not shorter:
            break
        order = shorter
    return tuple(places[k - 1] for k in order[1:])


def _are_same(q: Array, q_other: Array) -> bool:
    return bool(np.abs(q - q_other).max() <= AT_REACHED_RAD)

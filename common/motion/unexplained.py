"""Unexplained motion: an arm that leaves its rest pose while nothing accepted moves it. Pure.

Used by the robot process and by the arbiter, each with its own state and configuration. A goal, a
stream, force feedback and braking explain motion. After them the rest pose is taken when
the arm has run out: at one pose for a while, or after the longest run-out, so that a creeping arm
does not postpone it. Hand-guiding is no fault: motor power off or teach lock on.
"""

from collections.abc import Iterable
from math import degrees, radians
from typing import NamedTuple, Protocol

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import apart
from common.motion.tracking import DELAY_MARGIN
from forcemesh.faults import tripped
from forcemesh.messages import Trip

UNEXPLAINED = "unexplained_motion"
# Noise of the reported flange at rest.
REST_POSITION_M, REST_TURN_RAD = 2e-4, 2e-3
ROUNDINGS = 1.75  # packet units: half of one at either end, on three axes
# Of an arm that keeps its pose, at its flange: the lower end of industrial arms of this size.
ARM_STIFFNESS_N_m, ARM_STIFFNESS_Nm_rad = 1e5, 1e4
MARGIN = 2.0
AT_POSE_S = 0.3  # at one pose, besides twice the delay and three reports
RUN_OUT_S = 3.0  # from the end of a motion to rest at the latest, as of a hand-over
NS_PER_S = 1_000_000_000
REPORTS = 3  # in a row beyond the bounds
GUIDED = ("robot_motors", "robot_lock")  # codes under which a person may move the arm


class Reach(NamedTuple):
    """Distance from a pose, as a position and as a rotation."""

    position_m: float
    rotation_rad: float


REACH = Reach(5e-4, 3e-3)  # from the target, within which a goal is done


class PoseScales(Protocol):
    """Packet units of a pose."""

    @property
    def position_per_mm(self) -> int:
        """Units per millimetre."""

    @property
    def oat_per_deg(self) -> int:
        """Units per degree of O, A and T."""

    @property
    def joint_per_deg(self) -> int:
        """Units per degree of a joint."""


def reach_of(scales: PoseScales) -> Reach:
    """Return how near a goal must come: the rounding of coarse scales is no distance."""
    least_per_deg = min(scales.oat_per_deg, scales.joint_per_deg)
    return Reach(
        max(REACH.position_m, ROUNDINGS / scales.position_per_mm * 1e-3),
        max(REACH.rotation_rad, radians(ROUNDINGS / least_per_deg)),
    )


def rest_bounds(cell: CellConfig) -> Reach:
    """Return how far the flange may be from its rest pose: X [m] and Y [rad].

        X = 2 (reach + noise + limits.force_N / stiffness of the arm), Y likewise with the torque

    - reach: a goal is done within it, the rest of the travel may follow; it contains the rounding
      of the packet's scales (`reach_of`).
    - noise: of reports at rest, as measured on the simulated arm and the emulated controller.
    - compliance: a contact that changes by the whole force ceiling moves an arm that keeps its pose
      by force over stiffness; a force acts on the rotation through the longest tool, 0.3 m.
    - margin: 2.
    """
    limits, section = cell.limits, cell.gateway
    reach = REACH
    if section is not None:
        reach = reach_of(section.plain if section.protocol == "plain" else section)
    torque_Nm = limits.torque_Nm + 0.3 * limits.force_N
    return Reach(
        MARGIN * (reach.position_m + REST_POSITION_M + limits.force_N / ARM_STIFFNESS_N_m),
        MARGIN * (reach.rotation_rad + REST_TURN_RAD + torque_Nm / ARM_STIFFNESS_Nm_rad),
    )


class UnexplainedMotion:
    """Comparison of each report of an arm that nothing moves with the pose at which it rested."""

    def __init__(self, cell: CellConfig) -> None:
        """Begin without a rest pose."""
        self._bounds = rest_bounds(cell)
        delay_s = DELAY_MARGIN * cell.plant.servo_s
        self._rest_ns = round((AT_POSE_S + delay_s + REPORTS / cell.rates.robot_hz) * NS_PER_S)
        self.explain()

    def explain(self) -> None:
        """Register that something accepted moves the arm, or that its pose is not known."""
        self._since_ns: int | None = None  # end of the last explained motion
        self._T_rest: pin.SE3 | None = None  # candidate until it is taken
        self._at_pose_ns = self._last_ns = 0
        self._is_taken = False
        self._beyond = 0  # reports in a row

    def judge(self, T_base_flange: pin.SE3, at_ns: int) -> Trip | None:
        """Check a report while nothing explains motion; one with the time of the last is the same.

        A motion that was found is returned until `explain`.
        """
        if self._since_ns is None or self._T_rest is None:
            self._since_ns = self._at_pose_ns = self._last_ns = at_ns
            self._T_rest = T_base_flange
            return None
        distance_m, turn_rad = apart(self._T_rest, T_base_flange)
        if at_ns != self._last_ns:
            self._last_ns = at_ns
            if not self._is_taken:
                self._run_out(T_base_flange, distance_m, turn_rad)
            elif self._beyond < REPORTS:
                is_near = (
                    distance_m <= self._bounds.position_m and turn_rad <= self._bounds.rotation_rad
                )
                self._beyond = 0 if is_near else self._beyond + 1
        if self._beyond < REPORTS:
            return None
        return _trip(self._bounds, distance_m, turn_rad)

    def _run_out(self, T_base_flange: pin.SE3, distance_m: float, turn_rad: float) -> None:
        """Take the rest pose once the arm has been there for a while, or has had its time."""
        assert self._since_ns is not None  # noqa: S101 - `judge` has set it
        if not (distance_m <= REST_POSITION_M and turn_rad <= REST_TURN_RAD):
            self._T_rest, self._at_pose_ns = T_base_flange, self._last_ns
        has_rested = self._last_ns - self._at_pose_ns >= self._rest_ns
        self._is_taken = has_rested or self._last_ns - self._since_ns >= RUN_OUT_S * NS_PER_S


def is_guided(faults: Iterable[Trip]) -> bool:
    """Return whether a person may be moving the arm, by the robot's faults."""
    return any(fault.code in GUIDED for fault in faults)


def _trip(bounds: Reach, distance_m: float, turn_rad: float) -> Trip:
    if not distance_m <= bounds.position_m:
        text = f"the arm is {distance_m * 1e3:.2f} mm away from where it rested"
        text = f"{text}, and no command explains it"
        limit_m = bounds.position_m
        return tripped(UNEXPLAINED, text, value=distance_m, limit=limit_m, unit="m")
    text = f"the arm is turned {degrees(turn_rad):.2f} degrees from where it rested"
    text = f"{text}, and no command explains it"
    limit_rad = bounds.rotation_rad
    return tripped(UNEXPLAINED, text, value=turn_rad, limit=limit_rad, unit="rad")

"""Robot program of the fake controller: execution of commands, and the arm that it moves.

It keeps its own scales, so that a mistake in the gateway's conversions is not mirrored here.
"""

from collections import deque
from dataclasses import dataclass, field
from math import degrees, radians

import numpy as np
import pinocchio as pin

from common.motion.frames import Oat, R_from_oat, oat_from_R
from controller.packet import ZERO_VEC, Packet, VecInt
from controller.packet_table import FEEDBACK_BITS, GAIN_I, GAIN_P, NO_ID, Com, Status
from tests.fakes.arm import JOINT_MAX_RAD, JOINT_MIN_RAD, READY_RAD, FakeArm
from tests.fakes.pi_feedback import KeptLimits, PiFeedback

MOTIONS = (Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS, Com.SET_POINT)
SET_UP = {(Com.LIMITS, 0), (Com.LIMITS, 1), (Com.LIMITS, 2), (Com.LIMITS, 3), (Com.TCP, 0)}
READY = Status.MOTOR_POWER | Status.REPEAT_MODE | Status.TEACH_LOCK_OFF | Status.PROGRAM_RUNNING
SETTLED_RAD = 1e-5
_SI_PER_ONE = np.repeat([1e-3, radians(1.0)], 3)  # of a gain in mm or degrees


@dataclass(slots=True)
class RobotProgram:
    """The arm, the ring of commands, and all state that commands change."""

    arm: FakeArm = field(default_factory=FakeArm)
    lag_s: float = 0.02
    joint_rad: np.ndarray = field(default_factory=READY_RAD.copy)
    target_rad: np.ndarray = field(default_factory=READY_RAD.copy)
    status: Status = READY
    ring: deque[Packet] = field(default_factory=deque)
    taken_id: int = NO_ID
    held_id: int = NO_ID
    watchdog_s: float = 0.25
    rate_rad_s: float = np.inf  # of the joint with the longest travel
    scales: VecInt = ZERO_VEC
    gains_p: VecInt = ZERO_VEC
    gains_i: VecInt = ZERO_VEC
    speeds: VecInt = ZERO_VEC
    tcp: VecInt = ZERO_VEC
    centre: VecInt = ZERO_VEC
    limits: VecInt = ZERO_VEC
    motion_limits: VecInt = ZERO_VEC
    set_up: set[tuple[int, int]] = field(default_factory=set)  # on this connection
    setpoint: Packet | None = None  # of force, since the last hold or stop
    feedback: PiFeedback | None = None  # of the run in progress
    wrench: Packet | None = None  # the newest one, not used yet

    def take(self) -> None:
        """Execute the oldest command of the ring, if there is one."""
        if not self.ring:
            return
        packet = self.ring.popleft()
        self.taken_id = packet.id
        running = bool(self.status & FEEDBACK_BITS)
        self.set_up |= {(packet.com, packet.param)} & SET_UP
        may_move = not running and self.set_up == SET_UP
        if packet.com in MOTIONS and may_move:
            self._start_motion(packet)
        elif packet.com == Com.FEEDBACK and self.set_up == SET_UP:
            if not running:
                self._start_feedback()
            bit = (Status.POSITION_FEEDBACK, Status.ORIENTATION_FEEDBACK)[packet.param]
            self.status = (self.status & ~Status.HELD) | bit
        elif packet.com == Com.GAINS and packet.param:
            self.gains_i = packet.vec
        elif packet.com == Com.GAINS:
            self.gains_p = packet.vec
        elif packet.com == Com.SPEEDS:
            self.speeds = packet.vec
        elif packet.com == Com.LIMITS:
            self._keep(packet)
        elif packet.com == Com.TCP:
            self.tcp = self.tcp if packet.param else packet.vec
            self.centre = packet.vec
        else:
            self.status |= Status.TARGET_REFUSED

    def _keep(self, packet: Packet) -> None:
        """Store a bank of command 10; the emulated program checks the box."""
        if packet.param == 0:
            self.limits, self.watchdog_s = packet.vec, packet.vec[5] * 1e-3
        elif packet.param == 1:
            self.motion_limits = packet.vec

    def hold(self, id_: int) -> None:
        """Brake: stay at the present pose, clear the ring, end force feedback."""
        self.ring.clear()
        self.target_rad = self.joint_rad.copy()
        self.status = (self.status & ~FEEDBACK_BITS) | Status.HELD
        self.held_id, self.setpoint = id_, None

    def correct(self, now_s: float) -> None:
        """Step force feedback: the newest wrench, once, is a new target; a broken limit holds."""
        packet, self.wrench = self.wrench, None
        runs = [bool(self.status & bit) for bit in FEEDBACK_BITS]
        if packet is None or self.feedback is None or not any(runs):
            return
        aim = ZERO_VEC if self.setpoint is None else self.setpoint.vec
        wrench, aimed = (
            np.array(vec) / np.repeat(self.scales[3:5], 3) for vec in (packet.vec, aim)
        )
        T = self.feedback.next_flange(
            wrench,
            (wrench - aimed) * np.repeat(runs, 3),
            np.array(self.gains_p) * _SI_PER_ONE / GAIN_P,
            np.array(self.gains_i) * _SI_PER_ONE / GAIN_I,
            limits=self._kept(),
            now_s=now_s,
        )
        joints = None if T is None else self.arm.joints(T, self.target_rad)
        if joints is None:
            self.hold(self.held_id)
        else:
            self.target_rad = joints

    def move(self, dt_s: float) -> None:
        """Let the joints follow, first order, within the speed limits."""
        travel_rad = (self.target_rad - self.joint_rad) * (1.0 - np.exp(-dt_s / self.lag_s))
        fastest_rad = max(float(np.abs(travel_rad).max()), 1e-12)
        self.joint_rad = self.joint_rad + travel_rad * min(
            1.0, self.rate_rad_s * dt_s / fastest_rad
        )
        moving = bool(np.abs(self.target_rad - self.joint_rad).max() > SETTLED_RAD)
        self.status = (self.status & ~Status.MOVING) | (Status.MOVING if moving else Status(0))

    def pose_vec(self) -> VecInt:
        """Return X, Y, Z, O, A, T of the flange in packet units."""
        T = self.arm.pose(self.joint_rad)
        oat = [degrees(angle) * self.scales[1] for angle in oat_from_R(T.rotation)]
        x, y, z, o, a, t = (round(v) for v in (*(T.translation * 1e3 * self.scales[0]), *oat))
        return (x, y, z, o, a, t)

    def joint_vec(self) -> VecInt:
        """Return JT1 to JT6 in packet units."""
        units = np.degrees(self.joint_rad) * self.scales[2]
        a, b, c, d, e, f = (round(float(unit)) for unit in units)
        return (a, b, c, d, e, f)

    def _start_feedback(self) -> None:
        self.feedback = PiFeedback(self.arm.pose(self.joint_rad), self._pose(self.centre))
        self.target_rad, self.rate_rad_s, self.wrench = self.joint_rad.copy(), np.inf, None

    def _kept(self) -> KeptLimits:
        step, turn, speed, travel, force, _ = self.limits
        mm, degree, _, newton, newton_m, mm_s = self.scales
        return KeptLimits(
            step_m=step / mm * 1e-3,
            step_rad=radians(turn / degree),
            speed_m_s=speed / mm_s * 1e-3,
            travel_m=travel / mm * 1e-3,
            force_N=force / newton,
            torque_Nm=self.motion_limits[1] / newton_m,
        )

    def _pose(self, vec: VecInt) -> pin.SE3:
        oat = Oat(*(radians(units / self.scales[1]) for units in vec[3:]))
        return pin.SE3(R_from_oat(oat), np.array(vec[:3]) / self.scales[0] * 1e-3)

    def _start_motion(self, packet: Packet) -> None:
        target = self._target(packet)
        self.status &= ~(Status.TARGET_REFUSED | Status.HELD)
        if target is None or (target < JOINT_MIN_RAD).any() or (target > JOINT_MAX_RAD).any():
            self.status |= Status.TARGET_REFUSED
        else:
            self.target_rad = target
            self.rate_rad_s = self._rate_rad_s(target)

    def _rate_rad_s(self, target_rad: np.ndarray) -> float:
        """Return the joint rate of the flange at mechanical times modular speed."""
        speed_m_s = self.speeds[3] / self.scales[5] * 1e-3 * self.speeds[2] / 1e4
        flange_travel_m = float(np.linalg.norm(pin.log6(self._pose_on_path(target_rad)).vector[:3]))
        turn_rad = float(np.abs(target_rad - self.joint_rad).max())
        return (
            turn_rad * speed_m_s / flange_travel_m
            if flange_travel_m > 1e-6 and speed_m_s > 0.0
            else np.inf
        )

    def _pose_on_path(self, target_rad: np.ndarray) -> pin.SE3:
        return self.arm.pose(self.joint_rad).actInv(self.arm.pose(target_rad))

    def _target(self, packet: Packet) -> np.ndarray | None:
        if packet.com in {Com.MOVE_POSE, Com.SET_POINT}:
            return self.arm.joints(self._pose(packet.vec), self.target_rad)
        joints = np.radians(np.array(packet.vec) / self.scales[2])
        return joints + self.joint_rad if packet.com == Com.MOVE_BY_JOINTS else joints

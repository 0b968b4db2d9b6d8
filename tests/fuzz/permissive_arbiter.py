"""Permissive in-memory controller: executes every command; gateway link of the hostile arbiter.

It accepts every packet at once, moves linearly to each pose at the commanded speed, and stores all
packets for the judge. It has no kinematics: joints are independent numbers.
"""

from math import radians

import numpy as np
import pinocchio as pin

from common.motion.frames import Oat, R_from_oat, oat_from_R
from controller.packet import Packet, PacketReader, encode
from controller.packet_table import NO_ID, Com, Status, pack_status
from services.gateway.link import LinkEvents

REPORT_MS = 16
READY = Status.MOTOR_POWER | Status.REPEAT_MODE | Status.TEACH_LOCK_OFF | Status.PROGRAM_RUNNING
MOTIONS = (Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS, Com.SET_POINT)


class PermissiveController:
    """Link of the gateway; `sent` holds the packets since it was last cleared."""

    def __init__(self, joint_rad: tuple[float, ...]) -> None:
        """Start at the demo's home pose."""
        self.connections, self.last_fault = 0, ""
        self.sent: list[bytes] = []
        self.T = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.475, 0.377]))
        self.joint_rad = np.array(joint_rad)
        self._target = self.T.copy()
        self._reader = PacketReader()
        self._scales = (50, 500, 250, 100, 1000, 10)
        self._status, self._id, self._samples = READY, NO_ID, 0
        self._next_ns = self._now_ns = 0
        self._outbox, self._open, self._speed_m_s = b"", False, 0.0

    def poll(self, now_ns: int) -> LinkEvents:
        """Advance to `now_ns`; return the events."""
        opened, self._open = not self._open, True
        self.connections += opened
        self._move((now_ns - self._now_ns) * 1e-9)
        self._now_ns = now_ns
        if self._id and now_ns >= self._next_ns:
            self._next_ns = now_ns + REPORT_MS * 1_000_000
            self._report()
        data, self._outbox = self._outbox, b""
        return LinkEvents(opened, data, "")

    def send(self, data: bytes, now_ns: int) -> bool:
        """Receive packets."""
        for packet in self._reader.feed(data):
            self._take(packet)
        self.sent += [data[at : at + 63] for at in range(0, len(data), 63)]
        return True

    def greeted(self) -> None:
        """Do nothing."""

    def close(self, reason: str, now_ns: int) -> None:
        """Do nothing: this link does not fail."""
        raise AssertionError(reason)

    def _take(self, packet: Packet) -> None:
        self._id, com, vec = packet.id, Com(packet.com), packet.vec
        if com == Com.HELLO:
            self._scales = vec
            self._outbox += encode(packet)
        elif com == Com.HOLD:
            self._target = self.T.copy()
            self._status = READY | Status.HELD
        elif com == Com.SPEEDS:
            self._speed_m_s = vec[3] / self._scales[5] * 1e-3 * vec[2] / 1e4
        elif com == Com.FEEDBACK:
            bits = (Status.POSITION_FEEDBACK, Status.ORIENTATION_FEEDBACK, None)[packet.param]
            self._status = READY if bits is None else (self._status & ~Status.HELD) | bits
        elif com in MOTIONS:
            self._status &= ~Status.HELD
            joints = np.radians(np.array(vec) / self._scales[2])
            if com in {Com.MOVE_POSE, Com.SET_POINT}:
                self._target = pose_of_vec(vec, self._scales)
            elif com == Com.MOVE_JOINTS:
                self.joint_rad = joints
            else:
                self.joint_rad = self.joint_rad + joints

    def _move(self, dt_s: float) -> None:
        offset = self._target.translation - self.T.translation
        length = float(np.linalg.norm(offset))
        if length > 1e-9:
            share = min(1.0, self._speed_m_s * dt_s / length)
            self.T = pin.SE3(self._target.rotation, self.T.translation + share * offset)
        else:
            self.T = self._target.copy()

    def _report(self) -> None:
        self._samples += 1
        moving = bool(np.linalg.norm(self._target.translation - self.T.translation) > 1e-6)
        status = self._status | (Status.MOVING if moving else Status(0))
        param = pack_status(self._samples, status)
        mm, degree, joint = self._scales[:3]
        p = (round(float(value) * 1e3 * mm) for value in self.T.translation)
        oat = (round(float(np.degrees(a)) * degree) for a in oat_from_R(self.T.rotation))
        x, y, z, o, a, t = (*p, *oat)
        self._outbox += encode(Packet(self._id, Com.POSE, param, (x, y, z, o, a, t)))
        j1, j2, j3, j4, j5, j6 = (round(float(v) * joint) for v in np.degrees(self.joint_rad))
        self._outbox += encode(Packet(self._id, Com.JOINTS, param, (j1, j2, j3, j4, j5, j6)))


def pose_of_vec(vec: tuple[int, ...], scales: tuple[int, ...]) -> pin.SE3:
    """Return the flange pose of six packet units."""
    oat = Oat(*(radians(units / scales[1]) for units in vec[3:]))
    return pin.SE3(R_from_oat(oat), np.array(vec[:3]) / scales[0] * 1e-3)

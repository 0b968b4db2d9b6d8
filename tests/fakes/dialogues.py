"""Dialogues in memory: their outgoing packets, and reports of a controller for them."""

import numpy as np
import pinocchio as pin

from controller.packet import Packet, PacketReader, encode
from controller.packet_table import ID_LAST, Com, Scales, Status, pack_status
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Gains, Speed
from services.gateway.dialogue import Dialogue
from services.gateway.packet_window import id_of
from services.gateway.packets import ControllerLimits, Pacing

MS = NS_PER_S // 1000
SCALES = Scales()
GAINS = Gains(force_p_m_per_N=(1e-6, 1e-6, 1e-6))
KEPT = ControllerLimits(
    step_m=0.002, step_rad=0.02, speed_m_s=0.05, travel_m=0.1, force_N=60.0, watchdog_s=0.25,
    turn_rad=2.0, torque_Nm=10.0, set_point_m=0.02, set_point_rad=0.1, fastest_m_s=0.25,
    lower_m=(-0.5, 0.0, -0.1), upper_m=(0.5, 1.0, 0.9),
    T_flange_tcp=pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.16])),
    least_segment_s=0.03, least_speed_m_s=0.0012, joint_speed_rad_s=(3.0, 3.0, 3.0, 6.0, 6.0, 9.0),
)  # fmt: skip
JOINTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
SPEED = Speed()
QUIET = Status(0)
NONE = (0.0, 0.0, 0.0)  # no torque, no set point


def packets(data: bytes) -> list[Packet]:
    """Return the packets that a dialogue has to send."""
    return PacketReader().feed(data)


def coms(data: bytes) -> list[tuple[int, int]]:
    """Return (Com, Param) of the packets that a dialogue has to send."""
    return [(packet.com, packet.param) for packet in packets(data)]


def last_id(dialogue: Dialogue) -> int:
    """Return the ID of the last packet handed out for sending."""
    return id_of(dialogue.window.last)


def at(x_mm: float) -> pin.SE3:
    """Return a pose shifted along x."""
    return pin.SE3(np.eye(3), np.array([x_mm * 1e-3, 0.4, 0.3]))


def pose_report(taken_id: int, status: Status = QUIET) -> bytes:
    """Return 101 as the controller sends it."""
    return encode(Packet(taken_id, Com.POSE, pack_status(1, status)))


def joint_report(framed_id: int) -> bytes:
    """Return 102 as the controller sends it."""
    return encode(Packet(framed_id, Com.JOINTS, pack_status(1, Status(0))))


def greeted(pacing: Pacing | None = None, last_id: int = ID_LAST) -> Dialogue:
    """Return a dialogue after both hellos, at time 0."""
    dialogue = Dialogue(SCALES, pacing, last_id=last_id)
    hello = dialogue.connected(0)
    dialogue.feed(hello, 0)
    assert dialogue.ready
    return dialogue


def in_feedback() -> Dialogue:
    """Return a dialogue whose controller runs position feedback."""
    dialogue = greeted()
    dialogue.start_feedback("position", GAINS, permitted=True, now_ns=0)
    dialogue.feed(pose_report(last_id(dialogue), Status.POSITION_FEEDBACK), 0)
    dialogue.feed(joint_report(last_id(dialogue)), 0)
    return dialogue

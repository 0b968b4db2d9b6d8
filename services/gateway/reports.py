"""Report decoder: packets of the controller (hello, 101, 102, 103) to SI."""

from dataclasses import dataclass
from math import radians

import numpy as np
import pinocchio as pin

from common.motion.frames import Oat, R_from_oat
from controller.packet import Packet
from controller.packet_table import (
    ID_FIRST,
    PERCENT,
    PROTOCOL_VERSION,
    REPORTS,
    Com,
    Status,
    greeted,
    known,
    unpack_status,
)
from forcemesh.errors import RemoteProtocolError
from forcemesh.messages import Joints
from services.gateway.scales import Scales, differences, scales_from_hello


@dataclass(frozen=True, slots=True)
class HelloReceived:
    """The controller's hello: same protocol version, with the requested scales."""

    scales: Scales


@dataclass(frozen=True, slots=True)
class PoseReport:
    """101: flange in base, ID of the last command executed by the robot program."""

    T_base_flange: pin.SE3
    taken_id: int
    counter: int
    status: Status


@dataclass(frozen=True, slots=True)
class JointReport:
    """102: joint angles, ID of the last command framed by the receiver."""

    joint_rad: Joints
    framed_id: int
    counter: int
    status: Status


@dataclass(frozen=True, slots=True)
class HealthReport:
    """103: health of the controller's program."""

    error_code: int
    loop_count: int
    wrench_age_s: float
    queue_length: int
    monitor_speed_fraction: float
    held_id: int  # of the last hold; hello is one
    any_peer: bool  # fm.peer names no address: any client may connect


Event = HelloReceived | PoseReport | JointReport | HealthReport


def parse_hello(packet: Packet, asked: Scales, arm: int) -> HelloReceived:
    """Return the controller's hello.

    Raises RemoteProtocolError when the first packet is another one, or when version, number of the
    arm or scales differ from the requested ones; the text contains both and the remedy.
    """
    if packet.com != Com.HELLO:
        raise RemoteProtocolError(
            f"the controller's first packet is command {packet.com}, it must be hello "
            f"({int(Com.HELLO)}): is the program that ships with this version loaded?"
        )
    version, number = greeted(packet.param)
    if version != PROTOCOL_VERSION:
        raise RemoteProtocolError(
            f"the controller's program speaks protocol {version}, this gateway {PROTOCOL_VERSION}: "
            "load controller/forcemesh.as of this version, then EXECUTE fm.main"
        )
    if number != arm:
        raise RemoteProtocolError(
            f"this is arm {number}, the cell file's gateway.arm is {arm}: are cables or addresses "
            "of two arms swapped? If not, make fm.num in fm.config and gateway.arm the same"
        )
    answered = scales_from_hello(packet.vec)
    if wrong := differences(asked, answered):
        raise RemoteProtocolError(f"the controller did not set our scales: {'; '.join(wrong)}")
    return HelloReceived(answered)


def parse_report(packet: Packet, scales: Scales) -> PoseReport | JointReport | HealthReport:
    """Return a report in SI. Raise RemoteProtocolError for any other packet."""
    com = known(packet.com, packet.param)
    if com not in REPORTS:
        raise RemoteProtocolError(f"the controller sent a gateway command, {packet.com}")
    if com == Com.HELLO:
        raise RemoteProtocolError("the controller sent hello twice")
    if com == Com.HEALTH:
        return _health(packet)
    counter, status = unpack_status(packet.param)
    if com == Com.POSE:
        return PoseReport(_pose(packet, scales), packet.id, counter, status)
    return JointReport(_joints(packet, scales), packet.id, counter, status)


def _pose(packet: Packet, scales: Scales) -> pin.SE3:
    x, y, z, o, a, t = packet.vec
    oat = Oat(*(radians(angle / scales.oat_per_deg) for angle in (o, a, t)))
    return pin.SE3(R_from_oat(oat), np.array([x, y, z]) / scales.position_per_mm * 1e-3)


def _joints(packet: Packet, scales: Scales) -> Joints:
    a, b, c, d, e, f = (radians(units / scales.joint_per_deg) for units in packet.vec)
    return (a, b, c, d, e, f)


def _health(packet: Packet) -> HealthReport:
    loops, wrench_age_ms, queued, monitor_speed, held, any_peer = packet.vec
    return HealthReport(
        error_code=packet.param,
        loop_count=loops,
        wrench_age_s=wrench_age_ms * 1e-3,
        queue_length=queued,
        monitor_speed_fraction=monitor_speed / PERCENT / 100.0,
        held_id=ID_FIRST + held,
        any_peer=any_peer != 0,
    )

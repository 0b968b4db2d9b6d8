"""Link to a controller that runs plain.as: it presents protocol plain as our own. No socket.

Dialogue and driver stay as they are: they send our packets to this link and receive ours from it.
Each command for the controller has an ID of protocol plain, and the echo of that ID is converted
back; a command without a counterpart is acknowledged here, as soon as all before it are.

Status bits are what was commanded and is taken, and whether the joints turn. Motor power, mode,
teach lock and errors are not reported: these four bits are assumed. A hold while a motion waits to
be taken, and one that is not taken in time, close the connection: plain.as then drops what waits,
brakes, and accepts the next connection when it has braked.
"""

from collections import deque
from typing import NamedTuple

from common.config.cell import CellConfig, GatewaySection
from controller import plain
from controller.packet import Packet, PacketReader, VecInt, encode
from controller.packet_table import NO_ID, TABLE, Com, Status, greeting, pack_status
from controller.plain import ID_LAST, PlainReader
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from services.gateway.connection import ByteLink
from services.gateway.link import LinkEvents
from services.gateway.plain_commands import MOTIONS, PlainCommands, own_vector

HOLD_TAKEN_WITHIN_S = 0.5
MOVING_WINDOW_NS = 100_000_000
STILL_UNITS = 1  # of all joints together in the window: rounding at rest
# An arm that does not move, for whatever cause, is noticed by its goal.
ASSUMED = Status.MOTOR_POWER | Status.REPEAT_MODE | Status.TEACH_LOCK_OFF | Status.PROGRAM_RUNNING


class Pending(NamedTuple):
    """One of our commands that is not echoed yet."""

    number: int  # of the last packet for the controller up to it
    id: int  # ours
    in_ring: bool  # echoed by our 101
    after: Status  # status once it is taken


class PlainLink:
    """Byte link of a controller that runs plain.as."""

    def __init__(self, wire: ByteLink, cell: CellConfig, section: GatewaySection) -> None:
        """Wrap the link to the controller."""
        self._wire, self._cell, self._section = wire, cell, section
        self._begin()

    def _begin(self) -> None:
        """Begin a connection: IDs from 1."""
        chars = self._section.plain.packet_chars
        self._ours, self._theirs = PacketReader(), PlainReader(chars)
        self._commands = PlainCommands(self._section, self._section.plain, self._cell.force)
        self._answer = b""  # to our hello, until the next poll
        self._is_greeted = False
        self._number = 0  # packets sent to the controller
        self._pose: Packet | None = None  # 101 whose 102 has not been received
        self._samples = 0
        self._framed_id = self._taken_id = NO_ID  # ours
        self._framed = self._taken = 0  # numbers
        self._to_frame: deque[Pending] = deque()
        self._to_take: deque[Pending] = deque()
        self._status = Status.HELD
        self._hold: tuple[int, int] | None = None  # number, time of one that is not taken yet
        self._wrench = 0  # number of the last command 4
        self._motion = 0  # number of the last motion
        self._joints: deque[tuple[int, VecInt]] = deque()

    # --- the link ---------------------------------------------------------------------------------

    @property
    def connections(self) -> int:
        """Number of connections opened so far."""
        return self._wire.connections

    @property
    def last_fault(self) -> str:
        """Why the last connection or attempt ended."""
        return self._wire.last_fault

    def poll(self, now_ns: int) -> LinkEvents:
        """Return the events since the last poll; the data are packets of our own protocol.

        Raises RemoteProtocolError for anything but reports of protocol plain in pairs.
        """
        events = self._wire.poll(now_ns)
        if events.opened:
            self._begin()
        answer, self._answer = self._answer, b""
        data = answer + b"".join(
            self._sample(packet, now_ns) for packet in self._theirs.feed(events.data)
        )
        if self._hold is not None and now_ns - self._hold[1] > HOLD_TAKEN_WITHIN_S * NS_PER_S:
            limit_ms = HOLD_TAKEN_WITHIN_S * 1e3
            self._hold = None
            self._wire.close(f"plain.as has not taken a hold in {limit_ms:.0f} ms", now_ns)
        return LinkEvents(events.opened, data, events.lost)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Send what our packets are in protocol plain.

        Raises LocalProtocolError after the rest was sent when one of them cannot be.
        """
        sent, refusal = b"", None
        for packet in self._ours.feed(data):
            try:
                sent += self._encoded(packet, now_ns)
            except LocalProtocolError as error:
                refusal = refusal or error
            self._register(packet)
        is_open = self._wire.send(sent, now_ns) if sent else True
        if refusal is not None:
            raise refusal
        return is_open

    def greeted(self) -> None:
        """Register a valid hello: our own answer."""
        self._wire.greeted()

    def close(self, reason: str, now_ns: int) -> None:
        """Close the connection."""
        self._wire.close(reason, now_ns)

    # --- commands ---------------------------------------------------------------------------------

    def _encoded(self, packet: Packet, now_ns: int) -> bytes:
        data, number = b"", self._number
        if packet.com == Com.HOLD and self._motion > self._taken:
            self._wire.close("a hold voids a motion that plain.as has not taken yet", now_ns)
            return b""
        if packet.com == Com.WRENCH and self._wrench > self._taken:
            return b""  # pl.main takes 4 in turn: a second one would only wait
        for command in self._commands.translated(packet):
            id_ = 1 + number % ID_LAST
            data += plain.encode(command.packet(id_), self._section.plain.packet_chars)
            number += 1
        if packet.com == Com.HOLD and data:
            self._hold = (number, now_ns)
        if packet.com == Com.WRENCH:
            self._wrench = number
        if packet.com in MOTIONS:
            self._motion = number
        self._number = number
        return data

    def _register(self, packet: Packet) -> None:
        if packet.com == Com.HELLO:
            answer = Packet(packet.id, Com.HELLO, greeting(self._section.arm), self._section.vec)
            self._answer, self._is_greeted = encode(answer), True
            self._framed_id = self._taken_id = packet.id
        in_ring = packet.param in TABLE[packet.com].ring
        pending = Pending(self._number, packet.id, in_ring, self._commands.after)
        self._to_frame.append(pending)
        self._to_take.append(pending)

    # --- reports ----------------------------------------------------------------------------------

    def _sample(self, report: Packet, now_ns: int) -> bytes:
        """Return our 101 and 102 for the second report of a sample, nothing before."""
        if (report.com == Com.POSE) != (self._pose is None):
            raise RemoteProtocolError(f"report {report.com} twice: 101 and 102 take turns")
        if self._pose is None:
            self._pose = report
            return b""
        pose, self._pose = self._pose, None
        if not self._is_greeted:
            return b""
        self._echo(pose.id, report.id)
        self._samples += 1
        status = ASSUMED | self._status
        if self._moves(report.vec, now_ns):
            status |= Status.MOVING
        param = pack_status(self._samples, status)
        scales, settings = self._section, self._section.plain
        return encode(
            Packet(self._taken_id, Com.POSE, param, own_vector(pose, scales, settings))
        ) + encode(Packet(self._framed_id, Com.JOINTS, param, own_vector(report, scales, settings)))

    def _echo(self, taken: int, framed: int) -> None:
        """Register the IDs that 101 and 102 echo."""
        self._framed = max(self._framed, self._number_of(framed))
        self._taken = max(self._taken, self._number_of(taken))
        while self._to_frame and self._to_frame[0].number <= self._framed:
            self._framed_id = self._to_frame.popleft().id
        while self._to_take and self._to_take[0].number <= self._taken:
            done = self._to_take.popleft()
            self._status = done.after
            if done.in_ring:
                self._taken_id = done.id
        if self._hold is not None and self._hold[0] <= self._taken:
            self._hold = None

    def _number_of(self, id_: int) -> int:
        """Return the number of an echoed ID; 0 is none yet."""
        if id_ == 0:
            return 0
        number = self._number - (self._number - id_) % ID_LAST
        if number < 1:
            raise RemoteProtocolError(
                f"the controller echoes ID {id_}, which this connection has not sent"
            )
        return number

    def _moves(self, joints: VecInt, now_ns: int) -> bool:
        """Return whether the joints have turned in the last 0.1 s."""
        self._joints.append((now_ns, joints))
        while len(self._joints) > 2 and now_ns - self._joints[1][0] >= MOVING_WINDOW_NS:
            self._joints.popleft()
        before = self._joints[0][1]
        return sum(abs(a - b) for a, b in zip(joints, before, strict=True)) > STILL_UNITS

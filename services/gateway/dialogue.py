"""Sans-IO protocol state of the controller dialogue: bytes and times in, bytes and events out.

One connection:  connected() -> our hello;  feed() until HelloReceived;  then anything below.
Bytes returned by a method must be sent completely and in order, or the connection be closed.

Set points and wrenches are latest-value streams with flow control: `tick` sends the newest one when
the controller has executed the one before, because a queue in the controller adds delay, and delay
limits the bandwidth of a force loop. Without permission `tick` sends nothing: the controller's
watchdog then stops the motion.
"""

from collections import deque

import pinocchio as pin

from controller.packet import Packet, PacketReader, encode
from controller.packet_table import FEEDBACK_BITS, NO_ID, CentreParam, Com, Status
from forcemesh.errors import LocalProtocolError
from forcemesh.messages import Gains, Joints, Mode, Speed, Vec3
from services.gateway import commands
from services.gateway.commands import Command, ControllerLimits, Pacing, PoseCarry
from services.gateway.numbering import NONE_YET, EchoMark, id_of, number_of
from services.gateway.pending_commands import PendingCommands
from services.gateway.reports import Event, JointReport, PoseReport, parse_hello, parse_report
from services.gateway.round_trips import Echoes, is_taken
from services.gateway.scales import Scales

_NO_BITS = Status(0)
S_PER_NS = 1e-9


class Dialogue:
    """Protocol state of the gateway; one object serves many connections.

    `last`, `taken` and `framed` are packet numbers, which do not wrap around as the IDs do.
    """

    def __init__(
        self, scales: Scales, pacing: Pacing | None = None, *, arm: int = 1, last_id: int = NO_ID
    ) -> None:
        """Prepare the first connection, to the arm of this number.

        IDs continue from `last_id`, also across reconnections.
        """
        self.scales = scales
        self._arm = arm
        self._pacing = pacing or Pacing()
        self.last = number_of(last_id)  # the last packet handed out for sending
        self._reset()

    def _reset(self) -> None:
        """Reset the state of one connection."""
        self._reader = PacketReader()
        self._hello = NONE_YET
        self.ready = False  # both hellos are exchanged
        self.status = _NO_BITS
        self._last_for_ring = NONE_YET  # last packet that the robot program can echo
        self._taken = self._framed = EchoMark(NONE_YET)
        self.echoes = Echoes()
        self._last_sent_ns = 0
        self._motion = self._hold = NONE_YET  # the last ones; a hold voids the motion before
        self._setting_up: tuple[Command, ...] = ()
        self._set_up = NONE_YET  # the last of these
        self._speed: Speed | None = None
        self._requested_bits = _NO_BITS  # requested force feedback
        self._was_running = False
        self._reset_motion()

    def _reset_motion(self, running: Gains | None = None) -> None:
        """Reset the set-point stream and force feedback: nothing pending, no rounding carried."""
        self._pending = PendingCommands(self.scales, self._pacing, running)
        self._unexecuted: deque[int] = deque()

    # --- connection -------------------------------------------------------------------------------

    def connected(self, now_ns: int) -> bytes:
        """Start a connection: return our hello, its first packet."""
        self._reset()
        self._hello = self._last_for_ring = self.last + 1
        self._taken, self._framed = EchoMark(self._hello), EchoMark(self._hello)
        return self._send(now_ns, commands.hello(self.scales, self._arm))

    def feed(self, data: bytes, now_ns: int) -> list[Event]:
        """Return the events contained in received bytes.

        Raises RemoteProtocolError for anything malformed, unknown, or of another version or
        scale: the caller then closes the link and holds.
        """
        return [self._take(packet, now_ns) for packet in self._reader.feed(data)]

    def _take(self, packet: Packet, now_ns: int) -> Event:
        if not self.ready:
            hello = parse_hello(packet, self.scales, self._arm)
            self.ready = True
            self.echoes.framed.give_up()  # the time until the controller answers is no round trip
            return hello
        event = parse_report(packet, self.scales)
        if isinstance(event, PoseReport):
            self._taken.read(event.taken_id, self._last_for_ring)
            self.echoes.taken_up_to(self.taken, now_ns)
            self._follow_status(event.status)
            while self._unexecuted and self._unexecuted[0] <= self.taken:
                self._unexecuted.popleft()
        elif isinstance(event, JointReport):
            self._framed.read(event.framed_id, self.last)
            self.echoes.framed.reached(self.framed, now_ns)
        return event

    def _follow_status(self, status: Status) -> None:
        """Detect that the controller ended requested force feedback by itself."""
        self.status = status
        if self._requested_bits and status & self._requested_bits == self._requested_bits:
            self._was_running = True
        elif self._was_running:
            self._requested_bits, self._was_running = _NO_BITS, False

    # --- views ------------------------------------------------------------------------------------

    @property
    def last_id(self) -> int:
        """ID of the last packet handed out for sending."""
        return id_of(self.last)

    @property
    def taken(self) -> int:
        """Last packet of this connection executed by the robot program, or NONE_YET."""
        return self._taken.number

    @property
    def framed(self) -> int:
        """Last packet of this connection acknowledged by the receiver, or NONE_YET."""
        return self._framed.number

    @property
    def feedback_active(self) -> bool:
        """Whether force feedback is requested and not ended, or reported as running."""
        return bool(self._requested_bits or self.status & FEEDBACK_BITS)

    @property
    def unexecuted(self) -> int:
        """Number of streamed commands not yet executed by the robot program."""
        return len(self._unexecuted)

    @property
    def unacknowledged(self) -> int:
        """Number of packets not yet acknowledged by the controller's receiver."""
        return self.last - max(self._hello, self.framed)

    @property
    def settled(self) -> bool:
        """Whether reports reflect the last hold (framed) and the last motion (executed)."""
        return self._hold <= self.framed and self._motion <= self.taken

    @property
    def is_set_up(self) -> bool:
        """Whether the robot program has executed the commands required before motion."""
        return self._set_up <= self.taken

    # --- commands ---------------------------------------------------------------------------------

    def hold(self, now_ns: int) -> bytes:
        """Brake and hold now; permitted on any open connection.

        It voids commands not yet executed: an unfinished set-up is sent again.
        """
        self._stop_motion()
        data = self._send(now_ns, commands.HOLD)
        self._hold, self._motion = self.last, NONE_YET
        if not self.is_set_up:
            data += self._send(now_ns, *self._setting_up)
            self._set_up = self.last
        return data

    def move_to_pose(self, T_base_flange: pin.SE3, speed: Speed, now_ns: int) -> bytes:
        """Return command 1 as a goal, after its speeds if they have changed."""
        command, _ = commands.move_to_pose(T_base_flange, self.scales, PoseCarry())
        return self._goal(command, speed, now_ns)

    def move_to_joints(self, joint_rad: Joints, speed: Speed, now_ns: int) -> bytes:
        """Return command 2, after its speeds if they have changed."""
        return self._goal(commands.move_to_joints(joint_rad, self.scales), speed, now_ns)

    def move_by_joints(self, turn_rad: Joints, speed: Speed, now_ns: int) -> bytes:
        """Return command 3, after its speeds if they have changed."""
        return self._goal(commands.move_by_joints(turn_rad, self.scales), speed, now_ns)

    def offer_setpoint(self, T_base_flange: pin.SE3) -> None:
        """Store the newest pose of a stream; `tick` sends it when flow control permits."""
        self._refuse_during_feedback(Com.SET_POINT)
        self._pending.setpoint(T_base_flange)

    def offer_wrench(self, force_N: Vec3, torque_Nm: Vec3, setpoint_N: Vec3) -> None:
        """Store the newest wrench and its set point; `tick` sends them."""
        self._refuse_without_feedback("that could use a wrench")
        self._pending.wrench(force_N, torque_Nm, setpoint_N)

    def offer_centre(self, T_flange_tcp: pin.SE3) -> None:
        """Store the newest centre of rotation of force feedback; `tick` sends it."""
        self._refuse_without_feedback("whose centre could be moved")
        self._pending.centre(T_flange_tcp)

    def offer_gains(self, gains: Gains) -> None:
        """Store the newest gains of running force feedback; `tick` sends those that are new."""
        self._refuse_without_feedback("whose gains could be changed")
        self._pending.gains(gains)

    def set_speed(self, speed: Speed, now_ns: int) -> bytes:
        """Return the speeds command, empty if the controller has these speeds already."""
        data = self._send(now_ns, *self._speed_first(speed))
        self._speed = speed
        return data

    def set_up(self, kept: ControllerLimits, now_ns: int) -> bytes:
        """Return the set-up after hello: hold, which empties the ring, then the limits."""
        self._setting_up = commands.set_up(kept, self.scales)
        self._set_up = self.last + 1  # not executed
        return self.hold(now_ns)

    def set_centre(self, T_flange_centre: pin.SE3, now_ns: int) -> bytes:
        """Return the centre of rotation, to be sent before force feedback starts."""
        self._refuse_during_feedback(Com.TCP)
        return self._send(now_ns, commands.tcp(T_flange_centre, self.scales, CentreParam.CENTRE))

    def start_feedback(self, mode: Mode, gains: Gains, *, permitted: bool, now_ns: int) -> bytes:
        """Return gains and the start, in this order. Set points must have stopped before."""
        if not permitted:
            raise LocalProtocolError(
                "force feedback may not start without the arbiter's permission"
            )
        self._refuse_during_feedback(Com.FEEDBACK)
        data = self._send(now_ns, *commands.gains(gains), *commands.start_feedback(mode))
        self._reset_motion(gains)
        self._requested_bits, self._was_running = commands.BITS_OF_MODE[mode], False
        return data

    def stop_feedback(self, now_ns: int) -> bytes:
        """Stop force feedback; the arm stays where it is."""
        self._stop_motion()
        return self._send(now_ns, commands.STOP_FEEDBACK)

    def tick(self, now_ns: int, *, permitted: bool) -> bytes:
        """Return the bytes due now: a set point, a wrench or a heartbeat; none unpermitted."""
        if not permitted or not self.ready:
            self._pending.clear()
            return b""
        data = self._due_to_ring(now_ns) + self._due_wrench(now_ns)
        silence_s = (now_ns - self._last_sent_ns) * S_PER_NS
        if data or silence_s < self._pacing.heartbeat_after_s:
            return data
        if self.unacknowledged:  # a packet in flight is a heartbeat; more would delay a hold
            return b""
        return self._send(now_ns, commands.HEARTBEAT)

    # --- inside -----------------------------------------------------------------------------------

    def _stop_motion(self) -> None:
        """Void the commands not yet executed: no echo of them will arrive."""
        self._reset_motion()
        self._requested_bits, self._was_running = _NO_BITS, False
        self.echoes.give_up_taken()

    def _goal(self, command: Command, speed: Speed, now_ns: int) -> bytes:
        self._refuse_during_feedback(command.com)
        data = self._send(now_ns, *self._speed_first(speed), command)
        self._speed, self._motion = speed, self.last
        self._reset_motion()
        return data

    def _due_to_ring(self, now_ns: int) -> bytes:
        if self.unexecuted >= self._pacing.max_unexecuted:
            return b""
        due = self._pending.take_for_ring(now_ns)
        return b"".join(self._send_to_ring(now_ns, command) for command in due)

    def _send_to_ring(self, now_ns: int, command: Command) -> bytes:
        data = self._send(now_ns, command)
        self._unexecuted.append(self.last)
        self.echoes.streamed.sent(self.last, now_ns)
        self._motion = self.last
        return data

    def _due_wrench(self, now_ns: int) -> bytes:
        if self.unacknowledged >= self._pacing.max_unacknowledged:
            return b""
        return self._send(now_ns, *self._pending.take_wrench())

    def _speed_first(self, speed: Speed) -> tuple[Command, ...]:
        return () if speed == self._speed else (commands.speeds(speed, self.scales),)

    def _refuse_during_feedback(self, com: Com) -> None:
        if self.feedback_active:
            raise LocalProtocolError(
                f"command {int(com)} is refused while force feedback runs in the controller"
            )

    def _refuse_without_feedback(self, what_for: str) -> None:
        if not self.feedback_active:
            raise LocalProtocolError(f"no force feedback runs {what_for}")

    def _send(self, now_ns: int, *batch: Command) -> bytes:
        """Number and encode a batch: all of it, or an error and nothing."""
        if self._hello == NONE_YET:
            raise LocalProtocolError("there is no connection to send on")
        if not self.ready and any(c.com not in {Com.HELLO, Com.HOLD} for c in batch):
            raise LocalProtocolError("no hello has been received from the controller yet")
        numbered = [
            command.packet(id_of(number)) for number, command in enumerate(batch, self.last + 1)
        ]
        data = b"".join(encode(packet) for packet in numbered)
        for packet in numbered:
            self.last, self._last_sent_ns = self.last + 1, now_ns
            self.echoes.sent(packet, self.last, now_ns)
            if is_taken(packet):
                self._last_for_ring = self.last
        return data

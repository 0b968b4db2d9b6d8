"""Sans-IO protocol state of the controller dialogue: bytes and times in, bytes and events out.

One connection:  connected() -> our hello;  feed() until HelloReceived;  then anything below.
Bytes returned by a method must be sent completely and in order, or the connection be closed.

Set points and wrenches are latest-value streams with flow control: `tick` sends the newest one when
the controller has executed the one before, because a queue in the controller adds delay, and delay
limits the bandwidth of a force loop. Without permission `tick` sends nothing: the controller's
watchdog then stops the motion.
"""

import pinocchio as pin

from controller.packet import PacketReader, encode
from controller.packet_table import (
    FEEDBACK_BITS,
    MODES,
    NO_ID,
    CentreParam,
    Com,
    Scales,
    Status,
)
from forcemesh.errors import LocalProtocolError
from forcemesh.messages import ZERO3, Gains, Joints, Mode, Speed, Vec3
from services.gateway import packets
from services.gateway.packet_window import NONE_YET, PacketWindow, id_of
from services.gateway.packets import (
    Command,
    ControllerLimits,
    Event,
    JointReport,
    Pacing,
    PoseCarry,
    PoseReport,
    SignalReport,
    parse_hello,
    parse_report,
)

_NO_BITS = Status(0)
S_PER_NS = 1e-9


class Dialogue:
    """Protocol state of the gateway; one object serves many connections."""

    def __init__(
        self, scales: Scales, pacing: Pacing | None = None, *, arm: int = 1, last_id: int = NO_ID
    ) -> None:
        """Prepare the first connection, to the arm of this number.

        IDs continue from `last_id`, also across reconnections.
        """
        self.scales = scales
        self._arm = arm
        self._pacing = pacing or Pacing()
        self.window = PacketWindow(last_id)
        self._is_open = False
        self._reset()

    def _reset(self) -> None:
        """Reset the state of one connection."""
        self._reader = PacketReader()
        self.ready = False  # both hellos are exchanged
        self._last_sent_ns = 0
        self._motion = self._hold = NONE_YET  # the last ones; a hold voids the motion before
        self._is_stopped = False  # the last hold is taken and the arm at rest
        self._setting_up: tuple[Command, ...] = ()
        self._set_up = NONE_YET  # the last of these
        self._chosen = NONE_YET  # the choice of signals to report
        self._speed: Speed | None = None
        self._requested_bits = _NO_BITS  # requested force feedback
        self._was_running = False
        self.feedback_reported = False  # by the newest report, in any mode
        self._reset_motion()

    def _reset_motion(self, sent_gains: tuple[Command, ...] = ()) -> None:
        """Reset the set-point stream and force feedback: nothing pending, no rounding carried."""
        self._carry = packets.NO_CARRY
        self._sent_gains = sent_gains
        # The controller's set point is zero after a hold, a stop and hello.
        self._sent_set_point = packets.force_set_point(ZERO3, ZERO3, self.scales)
        self.window.streamed.in_flight.clear()
        self._drop_pending()

    def _drop_pending(self) -> None:
        """Drop what was offered and is not sent: the newest of each kind."""
        self._set_point: pin.SE3 | None = None
        self._encoded: tuple[Command, PoseCarry] | None = None  # of this pose and the present carry
        self._wrench: tuple[Command, ...] = ()
        self._centre: tuple[Command, ...] = ()
        self._gains: tuple[Command, ...] = ()

    # --- connection -------------------------------------------------------------------------------

    def connected(self, now_ns: int) -> bytes:
        """Start a connection: return our hello, its first packet."""
        self.window.begin()
        self._is_open = True
        self._reset()
        return self._send(now_ns, packets.hello(self.scales, self._arm))

    def disconnected(self) -> None:
        """End a connection: nothing is sent before the next hello."""
        self.ready = False

    def feed(self, data: bytes, now_ns: int) -> list[Event]:
        """Return the events contained in received bytes.

        Raises RemoteProtocolError for anything malformed, unknown, or of another version or
        scale: the caller then closes the link and holds.
        """
        events: list[Event] = []
        for packet in self._reader.feed(data):
            if not self.ready:
                events.append(parse_hello(packet, self.scales, self._arm))
                self.ready = True
                self.window.receipts.in_flight.clear()  # the wait for this hello is no round trip
                continue
            event = parse_report(packet, self.scales)
            if isinstance(event, SignalReport) and not self._has_chosen(event):
                continue
            events.append(event)
            if isinstance(event, PoseReport):
                self.window.taken_up_to(event.taken_id, now_ns)
                self.feedback_reported = bool(event.status & FEEDBACK_BITS)
                if self._requested_bits and self._requested_bits in event.status:
                    self._was_running = True
                elif self._was_running:  # the controller has ended it by itself
                    self._requested_bits, self._was_running = _NO_BITS, False
            elif isinstance(event, JointReport):
                self.window.framed_up_to(event.framed_id, now_ns)
                is_held = Status.HELD in event.status and Status.MOVING not in event.status
                self._is_stopped |= is_held and self._hold <= self.window.framed
        return events

    # --- views ------------------------------------------------------------------------------------

    @property
    def feedback_active(self) -> bool:
        """Whether force feedback is requested and not ended, or reported as running."""
        return self.feedback_reported or bool(self._requested_bits)

    @property
    def may_begin(self) -> bool:
        """Whether nothing before can move the arm: hold taken, arm at rest, feedback ended."""
        return self._is_stopped and not self.feedback_active

    @property
    def settled(self) -> bool:
        """Whether reports reflect the last hold (framed) and the last motion (executed)."""
        return self._hold <= self.window.framed and self._motion <= self.window.taken

    @property
    def is_set_up(self) -> bool:
        """Whether the robot program has executed the commands required before motion."""
        return self._set_up <= self.window.taken

    # --- commands that are sent at once -----------------------------------------------------------

    def hold(self, now_ns: int) -> bytes:
        """Brake and hold now; permitted on any open connection. No motion before `may_begin`.

        It voids commands not yet executed: an unfinished set-up is sent again.
        """
        self._stop_motion()
        data = self._send(now_ns, packets.HOLD)
        self._hold, self._motion, self._is_stopped = self.window.last, NONE_YET, False
        if not self.is_set_up:
            data += self._send(now_ns, *self._setting_up)
            self._set_up = self.window.last
        return data

    def set_up(self, kept: ControllerLimits, now_ns: int) -> bytes:
        """Return the set-up after hello: hold, which empties the ring, then the limits."""
        self._setting_up = packets.set_up(kept, self.scales)
        self._set_up = self.window.last + 1  # not executed
        return self.hold(now_ns)

    def choose_signals(self, selection: tuple[Command, ...], now_ns: int) -> bytes:
        """Return command 15 that chooses the signals to report; reports before it are ignored."""
        data = self._send(now_ns, *selection)
        self._chosen = self.window.last if selection else NONE_YET
        return data

    def command_now(self, command: Command, now_ns: int) -> bytes:
        """Return a command that the receiver executes at once and that moves nothing."""
        return self._send(now_ns, command)

    def set_speed(self, speed: Speed, now_ns: int) -> bytes:
        """Return the speeds command, empty if the controller has these speeds already."""
        data = self._send(now_ns, *self._speed_first(speed))
        self._speed = speed
        return data

    def move_to_pose(self, T_base_flange: pin.SE3, speed: Speed, now_ns: int) -> bytes:
        """Return command 1 as a goal, after its speeds if they have changed."""
        command, _ = packets.pose(Com.MOVE_POSE, T_base_flange, self.scales)
        return self._goal(command, speed, now_ns)

    def move_joints(self, com: Com, angles_rad: Joints, speed: Speed, now_ns: int) -> bytes:
        """Return command 2 or 3, after its speeds if they have changed."""
        return self._goal(packets.encoded(com, angles_rad, self.scales), speed, now_ns)

    def set_centre(self, T_flange_centre: pin.SE3, now_ns: int) -> bytes:
        """Return the centre of rotation, to be sent before force feedback starts."""
        self._refuse_during_feedback(Com.TCP)
        return self._send(now_ns, packets.tcp(T_flange_centre, self.scales, CentreParam.CENTRE))

    def start_feedback(self, mode: Mode, gains: Gains, *, permitted: bool, now_ns: int) -> bytes:
        """Return gains and the start, in this order. Set points must have stopped before."""
        if not permitted:
            raise LocalProtocolError(
                "force feedback may not start without the arbiter's permission"
            )
        self._refuse_during_feedback(Com.FEEDBACK)
        both = packets.gains(gains, self.scales)
        data = self._send(now_ns, *both, *packets.start_feedback(mode))
        self._reset_motion(both)
        self._requested_bits, self._was_running = MODES[mode], False
        return data

    def stop_feedback(self, now_ns: int) -> bytes:
        """Stop force feedback; the arm stays where it is."""
        self._stop_motion()
        return self._send(now_ns, packets.STOP_FEEDBACK)

    # --- streams: the newest value, sent by `tick` when flow control permits ----------------------

    def offer_setpoint(self, T_base_flange: pin.SE3) -> None:
        """Store the newest pose of a stream. Raises LocalProtocolError when it does not fit."""
        self._refuse_during_feedback(Com.SET_POINT)
        self._encoded = packets.pose(Com.SET_POINT, T_base_flange, self.scales, self._carry)
        self._set_point = T_base_flange

    def offer_wrench(
        self, force_N: Vec3, torque_Nm: Vec3, setpoint_N: Vec3, setpoint_Nm: Vec3 = ZERO3
    ) -> None:
        """Store the newest wrench and its set point."""
        self._refuse_without_feedback("that could use a wrench")
        set_point = packets.force_set_point(setpoint_N, setpoint_Nm, self.scales)
        self._wrench = (set_point, packets.wrench(force_N, torque_Nm, self.scales))

    def show_wrench(self, force_N: Vec3, torque_Nm: Vec3) -> None:
        """Store the newest wrench for a display in the controller: no force feedback uses it."""
        self._refuse_during_feedback(Com.WRENCH)
        self._wrench = (self._sent_set_point, packets.wrench(force_N, torque_Nm, self.scales))

    def offer_centre(self, T_flange_tcp: pin.SE3) -> None:
        """Store the newest centre of rotation of force feedback."""
        self._refuse_without_feedback("whose centre could be moved")
        self._centre = (packets.tcp(T_flange_tcp, self.scales, CentreParam.CENTRE),)

    def offer_gains(self, gains: Gains) -> None:
        """Store the newest gains of running force feedback."""
        self._refuse_without_feedback("whose gains could be changed")
        self._gains = packets.gains(gains, self.scales)

    def tick(self, now_ns: int, *, permitted: bool) -> bytes:
        """Return the bytes due now: a set point, a wrench or a heartbeat; none unpermitted.

        Of gains and set point of the wrench only what the controller does not have is sent.
        """
        if not permitted or not self.ready:
            self._drop_pending()
            return b""
        data = b""
        if self.window.unexecuted < self._pacing.max_unexecuted:
            due = self._due_setpoint(now_ns)
            if not due and self._gains:
                due = tuple(command for command in self._gains if command not in self._sent_gains)
                self._sent_gains, self._gains = self._gains, ()
            if not due:
                due, self._centre = self._centre, ()
            if due:
                data += self._send(now_ns, *due, streamed=True)
                self._motion = self.window.last
        if self._wrench and self.window.unacknowledged < self._pacing.max_unacknowledged:
            set_point, wrench = self._wrench  # it bypasses the ring
            due = (wrench,) if set_point == self._sent_set_point else (set_point, wrench)
            self._sent_set_point, self._wrench = set_point, ()
            data += self._send(now_ns, *due)
        silence_s = (now_ns - self._last_sent_ns) * S_PER_NS
        if data or silence_s < self._pacing.heartbeat_after_s:
            return data
        if self.window.unacknowledged:  # a packet in flight is a heartbeat: more delay a hold
            return b""
        return self._send(now_ns, packets.HEARTBEAT)

    def _due_setpoint(self, now_ns: int) -> tuple[Command, ...]:
        """Return the set point released now: the newest, or one towards it, which stays pending."""
        T_target = self._set_point
        T = None if T_target is None else self._pacing.release(T_target, now_ns)
        if T is None:
            return ()
        encoded, self._encoded = self._encoded, None  # the next pose has another carry
        if T is T_target:
            self._set_point = None
        if encoded is None or T is not T_target:
            encoded = packets.pose(Com.SET_POINT, T, self.scales, self._carry)
        command, self._carry = encoded
        return (command,)

    # --- inside -----------------------------------------------------------------------------------

    def _stop_motion(self) -> None:
        """Void the commands not yet executed."""
        self._reset_motion()
        self._requested_bits, self._was_running = _NO_BITS, False
        self.window.void()

    def _has_chosen(self, report: SignalReport) -> bool:
        """Return whether the receiver had executed our choice of signals before a report."""
        return self._chosen != NONE_YET and self.window.number_of(report.framed_id) >= self._chosen

    def _goal(self, command: Command, speed: Speed, now_ns: int) -> bytes:
        self._refuse_during_feedback(command.com)
        data = self._send(now_ns, *self._speed_first(speed), command)
        self._speed, self._motion = speed, self.window.last
        self._reset_motion()
        return data

    def _speed_first(self, speed: Speed) -> tuple[Command, ...]:
        return () if speed == self._speed else (packets.speeds(speed, self.scales),)

    def _refuse_during_feedback(self, com: Com) -> None:
        if self.feedback_active:
            raise LocalProtocolError(
                f"command {int(com)} is refused while force feedback runs in the controller"
            )

    def _refuse_without_feedback(self, what_for: str) -> None:
        if not self.feedback_active:
            raise LocalProtocolError(f"no force feedback runs {what_for}")

    def _send(self, now_ns: int, *batch: Command, streamed: bool = False) -> bytes:
        """Number and encode a batch: all of it, or an error and nothing."""
        if not self._is_open:
            raise LocalProtocolError("there is no connection to send on")
        if not self.ready and any(c.com not in {Com.HELLO, Com.HOLD} for c in batch):
            raise LocalProtocolError("no hello has been received from the controller yet")
        numbered = enumerate(batch, self.window.last + 1)
        data = b"".join(encode(command.packet(id_of(number))) for number, command in numbered)
        for command in batch:
            self._last_sent_ns = now_ns
            self.window.sent(command.com, command.param, now_ns, streamed=streamed)
        return data

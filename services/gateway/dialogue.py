"""The talk with the controller as pure state: bytes and times in, bytes and events out. No socket.

One connection:  connected() -> our hello;  feed() until HelloReceived;  then anything below.
What is returned by a method must be sent whole and in order, or the connection be given up.

Set points and wrenches are streams: the newest wins, and `tick` sends it when the controller has
taken the one before, because a queue in the controller is delay and delay is what limits a force
loop. Without permission `tick` sends nothing at all: the controller's own watchdog then stops it.
"""

from collections import deque

import pinocchio as pin

from common.errors import LocalProtocolError
from common.messages import Gains, Mode, Speed, Vec3, Vec6
from common.packet import Packet, PacketReader, encode
from common.packet_table import FEEDBACK_BITS, NO_ID, Com, Status, id_reached, ids_since, next_id
from services.gateway import commands
from services.gateway.commands import Command, ControllerLimits, Pacing, PoseCarry
from services.gateway.offers import Offers
from services.gateway.reports import Event, JointReport, PoseReport, parse_hello, parse_report
from services.gateway.round_trips import Echoes
from services.gateway.scales import Scales

_NO_BITS = Status(0)
S_PER_NS = 1e-9


class Dialogue:
    """Protocol state of the gateway's side; one object lives through many connections."""

    def __init__(
        self, scales: Scales, pacing: Pacing | None = None, *, last_id: int = NO_ID
    ) -> None:
        """Prepare the first connection. IDs go on from `last_id`, also over reconnects."""
        self.scales = scales
        self._pacing = pacing or Pacing()
        self.last_id = last_id  # of the last packet handed out for sending
        self._reset()

    def _reset(self) -> None:
        """Forget everything that belongs to one connection."""
        self._reader = PacketReader()
        self._hello_id = NO_ID
        self.ready = False  # both hellos are through
        self.status = _NO_BITS
        self.taken_id = NO_ID
        self.framed_id = NO_ID
        self.echoes = Echoes()
        self._last_sent_ns = 0
        self._motion_id = self._hold_id = NO_ID  # the last ones; a hold voids the motion before
        self._speed: Speed | None = None
        self._wanted_bits = _NO_BITS  # force feedback that was asked for
        self._was_running = False
        self._forget_motion()

    def _forget_motion(self, running: Gains | None = None) -> None:
        """A stream of set points, or force feedback, starts anew: nothing pending or carried."""
        self._offers = Offers(self.scales, self._pacing, running)
        self._untaken: deque[int] = deque()

    # --- connection -------------------------------------------------------------------------------

    def connected(self, now_ns: int) -> bytes:
        """Start a connection: return our hello, its first packet."""
        self._reset()
        self._hello_id = next_id(self.last_id)
        return self._send(now_ns, commands.hello(self.scales))

    def feed(self, data: bytes, now_ns: int) -> list[Event]:
        """Return what the controller said.

        Raises RemoteProtocolError for anything malformed, unknown, or of another version or
        scale: close the link then, and hold.
        """
        return [self._take(packet, now_ns) for packet in self._reader.feed(data)]

    def _take(self, packet: Packet, now_ns: int) -> Event:
        if not self.ready:
            hello = parse_hello(packet, self.scales)
            self.ready = True
            self.echoes.framed.give_up()  # that ours waited to be heard is no round trip
            return hello
        event = parse_report(packet, self.scales)
        if isinstance(event, PoseReport):
            self.taken_id = self._ours(event.taken_id)
            self.echoes.taken.reached(self.taken_id, now_ns)
            self._follow_status(event.status)
            while self._untaken and id_reached(self.taken_id, self._untaken[0]):
                self._untaken.popleft()
        elif isinstance(event, JointReport):
            self.framed_id = self._ours(event.framed_id)
            self.echoes.framed.reached(self.framed_id, now_ns)
        return event

    def _ours(self, id_: int) -> int:
        """Return the ID if it is of this connection; one of an earlier connection is none."""
        this_connection = id_reached(id_, self._hello_id) and id_reached(self.last_id, id_)
        return id_ if this_connection else NO_ID

    def _follow_status(self, status: Status) -> None:
        """Notice when the controller ended by itself the force feedback that was asked for."""
        self.status = status
        if self._wanted_bits and status & self._wanted_bits == self._wanted_bits:
            self._was_running = True
        elif self._was_running:
            self._wanted_bits, self._was_running = _NO_BITS, False

    # --- views ------------------------------------------------------------------------------------

    @property
    def feedback_active(self) -> bool:
        """Force feedback was asked for and has not ended, or the controller says that it runs."""
        return bool(self._wanted_bits or self.status & FEEDBACK_BITS)

    @property
    def untaken(self) -> int:
        """What goes through the ring and the robot program has not taken."""
        return len(self._untaken)

    @property
    def unframed(self) -> int:
        """Packets under way that the controller's receiver has not seen."""
        seen = self._hello_id if self.framed_id == NO_ID else self.framed_id
        return ids_since(seen, self.last_id)

    @property
    def settled(self) -> bool:
        """The controller has heard the last hold and taken the last motion: reports know both."""
        return all(
            id_ == NO_ID or id_reached(seen, id_)
            for id_, seen in ((self._hold_id, self.framed_id), (self._motion_id, self.taken_id))
        )

    # --- commands ---------------------------------------------------------------------------------

    def hold(self, now_ns: int) -> bytes:
        """Brake and hold now; allowed as soon as there is a connection."""
        self._stop_motion()
        data = self._send(now_ns, commands.HOLD)
        self._hold_id, self._motion_id = self.last_id, NO_ID
        return data

    def move_to_pose(self, T_base_flange: pin.SE3, speed: Speed, now_ns: int) -> bytes:
        """Command 1 as a goal, with its speeds first when they have changed."""
        command, _ = commands.move_to_pose(T_base_flange, self.scales, PoseCarry())
        return self._goal(command, speed, now_ns)

    def move_to_joints(self, joint_rad: Vec6, speed: Speed, now_ns: int) -> bytes:
        """Command 2, with its speeds first when they have changed."""
        return self._goal(commands.move_to_joints(joint_rad, self.scales), speed, now_ns)

    def move_by_joints(self, turn_rad: Vec6, speed: Speed, now_ns: int) -> bytes:
        """Command 3, with its speeds first when they have changed."""
        return self._goal(commands.move_by_joints(turn_rad, self.scales), speed, now_ns)

    def offer_setpoint(self, T_base_flange: pin.SE3) -> None:
        """Give the newest pose of a stream; `tick` sends it when its turn comes."""
        self._refuse_during_feedback(Com.MOVE_POSE)
        self._offers.setpoint(T_base_flange)

    def offer_wrench(self, force_N: Vec3, torque_Nm: Vec3) -> None:
        """Give the newest wrench minus set point; `tick` sends it when its turn comes."""
        self._refuse_without_feedback("to take a wrench")
        self._offers.wrench(force_N, torque_Nm)

    def offer_centre(self, T_flange_tcp: pin.SE3) -> None:
        """Give the newest point that force feedback turns about; `tick` sends it in its turn."""
        self._refuse_without_feedback("whose centre could be moved")
        self._offers.centre(T_flange_tcp)

    def offer_gains(self, gains: Gains) -> None:
        """Give the newest gains of running force feedback; `tick` sends those that are new."""
        self._refuse_without_feedback("whose gains could be changed")
        self._offers.gains(gains)

    def set_speed(self, speed: Speed, now_ns: int) -> bytes:
        """Send the speeds if the controller does not have them yet."""
        data = self._send(now_ns, *self._speed_first(speed))
        self._speed = speed
        return data

    def set_up(self, kept: ControllerLimits, now_ns: int) -> bytes:
        """After hello: hold (it empties the ring), then what the controller keeps to by itself."""
        return self.hold(now_ns) + self._send(now_ns, commands.limits(kept, self.scales))

    def set_tcp(self, T_flange_tcp: pin.SE3, now_ns: int) -> bytes:
        """Send the tool centre point before force feedback starts."""
        self._refuse_during_feedback(Com.TCP)
        return self._send(now_ns, commands.tcp(T_flange_tcp, self.scales))

    def start_feedback(
        self, mode: Mode, gains: Gains, kept: ControllerLimits, *, permitted: bool, now_ns: int
    ) -> bytes:
        """Send limits, gains and the start, in this order. Set points must have stopped before."""
        if not permitted:
            raise LocalProtocolError(
                "force feedback may not start without the arbiter's permission"
            )
        self._refuse_during_feedback(Com.FEEDBACK)
        limits, both = commands.limits(kept, self.scales), commands.gains(gains)
        data = self._send(now_ns, limits, *both, *commands.start_feedback(mode))
        self._forget_motion(gains)
        self._wanted_bits, self._was_running = commands.BITS_OF_MODE[mode], False
        return data

    def stop_feedback(self, now_ns: int) -> bytes:
        """Stop force feedback; the arm stays where it is."""
        self._stop_motion()
        return self._send(now_ns, commands.STOP_FEEDBACK)

    def tick(self, now_ns: int, *, permitted: bool) -> bytes:
        """Return what is due now: a set point, a wrench, or a heartbeat; nothing unpermitted."""
        if not permitted or not self.ready:
            self._offers.forget()
            return b""
        data = self._due_to_ring(now_ns) + self._due_wrench(now_ns)
        silence_s = (now_ns - self._last_sent_ns) * S_PER_NS
        if data or silence_s < self._pacing.heartbeat_after_s:
            return data
        if self.unframed:  # what is on its way is a beat; on a slow line a hold would queue behind
            return b""
        return self._send(now_ns, commands.HEARTBEAT)

    # --- inside -----------------------------------------------------------------------------------

    def _stop_motion(self) -> None:
        """What the robot program has not taken yet is void: no echo will come of it."""
        self._forget_motion()
        self._wanted_bits, self._was_running = _NO_BITS, False
        self.echoes.taken.give_up()

    def _goal(self, command: Command, speed: Speed, now_ns: int) -> bytes:
        self._refuse_during_feedback(command.com)
        data = self._send(now_ns, *self._speed_first(speed), command)
        self._speed, self._motion_id = speed, self.last_id
        self._forget_motion()
        return data

    def _due_to_ring(self, now_ns: int) -> bytes:
        if self.untaken >= self._pacing.max_untaken:
            return b""
        due = self._offers.take_for_ring(now_ns)
        return b"".join(self._send_to_ring(now_ns, command) for command in due)

    def _send_to_ring(self, now_ns: int, command: Command) -> bytes:
        data = self._send(now_ns, command)
        self._untaken.append(self.last_id)
        self._motion_id = self.last_id
        return data

    def _due_wrench(self, now_ns: int) -> bytes:
        if self.unframed >= self._pacing.max_unframed:
            return b""
        return self._send(now_ns, *self._offers.take_wrench())

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
        if self._hello_id == NO_ID:
            raise LocalProtocolError("there is no connection to send on")
        if not self.ready and any(c.com not in {Com.HELLO, Com.HOLD} for c in batch):
            raise LocalProtocolError("the controller has not said hello yet")
        batch_packets: list[Packet] = []
        for command in batch:
            before = batch_packets[-1].id if batch_packets else self.last_id
            batch_packets.append(command.packet(next_id(before)))
        data = b"".join(encode(packet) for packet in batch_packets)
        for packet in batch_packets:
            self.last_id, self._last_sent_ns = packet.id, now_ns
            self.echoes.sent(packet, now_ns)
        return data

"""Connection to the controller: link and dialogue joined, with the newest reports."""

from typing import Protocol

from common.runtime.signal_service import SignalReading
from controller.error_codes import error_shown
from controller.packet_table import FEEDBACK_BITS, MODES, Status
from forcemesh.clock import NS_PER_S
from forcemesh.errors import RemoteProtocolError
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import CONTROLLER_BITS, KawasakiStatus, LinkHealth, RobotStatus, Trip
from services.gateway.dialogue import Dialogue
from services.gateway.goals import REPORTS_TO_CONFIRM, ControllerReport
from services.gateway.link import LinkEvents
from services.gateway.packet_window import (
    LEAST_STREAMED,
    NONE_YET,
    Rate,
    WrappingCounterRate,
)
from services.gateway.packets import (
    ControllerLimits,
    Event,
    HealthReport,
    HelloReceived,
    PoseReport,
    SignalReport,
)
from services.gateway.signals import ControllerSignals, switch_output

SET_UP_WITHIN_NS = NS_PER_S  # time for the controller to execute its limits
LOOPS_SPAN = 500_000  # modulus of the loop counter of 103

# Faults of status bits: whether the bit is set when the arm may move.
FAULT_BITS = {
    Status.MOTOR_POWER: (True, "robot_motors"),
    Status.REPEAT_MODE: (True, "robot_teach"),
    Status.TEACH_LOCK_OFF: (True, "robot_lock"),
    Status.PROGRAM_RUNNING: (True, "robot_program"),
    Status.WATCHDOG_LATCHED: (False, "robot_latched"),
    Status.ERROR: (False, "robot_error"),
}


class ByteLink(Protocol):
    """Byte transport: a socket, or the emulator in lock step."""

    @property
    def connections(self) -> int:
        """Number of connections opened so far."""

    @property
    def last_fault(self) -> str:
        """Why the last connection or attempt ended."""

    def poll(self, now_ns: int) -> LinkEvents:
        """Return the events since the last poll.

        Raises RemoteProtocolError for data that are no packets, if the link is one that parses.
        """

    def send(self, data: bytes, now_ns: int) -> bool:
        """Queue bytes for sending."""

    def greeted(self) -> None:
        """Register a valid hello."""

    def close(self, reason: str, now_ns: int) -> None:
        """Close the connection."""


class ControllerConnection:
    """State of the connection to the controller."""

    def __init__(
        self,
        wire: ByteLink,
        dialogue: Dialogue,
        kept: ControllerLimits,
        *,
        stale_after_s: float,
        signals: ControllerSignals | None = None,
    ) -> None:
        """Join the two; `poll` connects. `kept` is sent after every hello and hold."""
        self._signals = signals or ControllerSignals({})
        self._switched = NONE_YET  # the last command that switched an output
        self.dialogue = dialogue
        self.errors = 0  # connections closed for a protocol error of the controller
        self.code = "robot_link"  # of `trouble`
        self._wire = wire
        self._kept = kept
        self._stale_after_s = stale_after_s
        self._greeted_ns = 0
        self._voided = 0  # consecutive reports with limits neither executed nor queued
        self._down()

    def poll(self, now_ns: int) -> bool:
        """Serve the link; return whether a new pose with its joints was received."""
        is_new, events = False, LinkEvents()
        try:
            events = self._wire.poll(now_ns)
            if events.opened:
                self.send(self.dialogue.connected(now_ns), now_ns)
            for event in self.dialogue.feed(events.data, now_ns) if events.data else ():
                is_new |= self._take(event, now_ns)
        except RemoteProtocolError as error:
            self.errors += 1
            self._wire.close(str(error), now_ns)
            self._down()
        if events.lost:
            self._down()
        # On a slower link a hold would arrive later than the controller's watchdog acts. Before its
        # limits are executed nothing moves, and a slow controller may take long to read them.
        in_flight = self.dialogue.window.receipts.in_flight
        is_set_up = self.dialogue.is_set_up
        most_s = self._kept.watchdog_s if is_set_up else SET_UP_WITHIN_NS / NS_PER_S
        age_s = (now_ns - in_flight[0][1]) / NS_PER_S if in_flight else 0.0
        if self.dialogue.ready and age_s > most_s:
            reason = f"a packet is in transit for {age_s * 1e3:.0f} ms, limit {most_s * 1e3:.0f} ms"
            self._wire.close(reason, now_ns)
            self._down()
            self.code = "link_slow"
        return is_new

    def close(self, now_ns: int) -> None:
        """Close the connection; `poll` would open a new one."""
        self._wire.close("closed by the gateway", now_ns)
        self._down()

    def send(self, data: bytes, now_ns: int) -> None:
        """Send the dialogue's bytes; a failure is reported by the next poll."""
        if data:
            self._wire.send(data, now_ns)

    def switch(self, number: int, *, on: bool, now_ns: int) -> Trip | None:
        """Switch an output, which the controller's receiver executes at once; or return why not.

        One at a time: a flood of requests must not delay the packets of a motion.
        """
        if self.dialogue.window.framed < self._switched:
            return tripped("wait", "the controller has not executed the output before it yet")
        self.send(self.dialogue.command_now(switch_output(number, on=on), now_ns), now_ns)
        self._switched = self.dialogue.window.last
        return None

    def signals(self, now_ns: int) -> SignalReading:
        """Return the state of the signals; unknown while the link has a fault."""
        if fault := self.link_fault(now_ns):
            return SignalReading(code=self.code, reason=fault)
        return self._signals.reading(now_ns)

    def link_fault(self, now_ns: int) -> str:
        """Return why the robot cannot be commanded, empty when it can."""
        if not self.dialogue.ready:
            return self._wire.last_fault or "not connected to the controller yet"
        if self.measured is None:
            return "no pose from the controller yet"
        age_s = (now_ns - self.measured.at_ns) / NS_PER_S
        if age_s > self._stale_after_s:
            limit_ms = self._stale_after_s * 1e3
            return f"the controller's pose is {age_s * 1e3:.0f} ms old, limit {limit_ms:.0f} ms"
        is_starting_up = now_ns - self._greeted_ns < SET_UP_WITHIN_NS
        if is_starting_up and not self.dialogue.is_set_up and self.status.ready:
            return "the controller is receiving its limits"
        return ""

    def controller_fault(self) -> Trip | None:
        """Return the status bits that prevent motion."""
        if faults := self.status.faults:
            return tripped(faults[0].code, "; ".join(fault.text for fault in faults))
        if not self.dialogue.is_set_up:
            return tripped("robot_program", "the controller's program does not execute its limits")
        return None

    def link_health(self) -> LinkHealth:
        """Return the health of the link."""
        return LinkHealth(
            connected=self.dialogue.ready,
            round_trip_s=self.dialogue.window.receipts.last_s,
            reconnects=max(0, self._wire.connections - 1),
            errors=self.errors,
        )

    def numbers(self, now_ns: int) -> dict[str, float]:
        """Return the measurements of this connection: times [s], rates [1/s]; none unknown."""
        found: dict[str, float | None] = {}
        if self.dialogue.ready:
            window = self.dialogue.window
            for name, trips in (("framed", window.receipts), ("taken", window.executions)):
                spread = trips.spread(now_ns)
                found[f"{name}_round_trip_p50_s"] = None if spread is None else spread.p50_s
                found[f"{name}_round_trip_p99_s"] = None if spread is None else spread.p99_s
            streamed = window.streamed.spread(now_ns, LEAST_STREAMED)
            found["streamed_round_trip_p50_s"] = None if streamed is None else streamed.p50_s
            found["program_loop_hz"] = self._loops.hz(now_ns)
            found["sender_hz"] = self._samples.hz(now_ns)
        if self.health is not None:
            found["monitor_speed_fraction"] = self.health.monitor_speed_fraction
            found["any_peer_may_connect"] = float(self.health.any_peer)
        return {name: number for name, number in found.items() if number is not None}

    def _set_up_again(self, health: HealthReport, now_ns: int) -> None:
        """Send the limits again if they are neither executed nor queued: a hold voided them."""
        is_void = health.queue_length == 0 and self.dialogue.window.unacknowledged == 0
        self._voided = self._voided + 1 if is_void and not self.dialogue.is_set_up else 0
        if self._voided >= REPORTS_TO_CONFIRM:
            self._voided = 0
            self.send(self.dialogue.hold(now_ns), now_ns)

    def _down(self) -> None:
        """Forget what was received over a connection."""
        self.dialogue.disconnected()
        self._signals.disconnected()
        self._switched = NONE_YET
        self._pose: PoseReport | None = None
        self.measured: ControllerReport | None = None
        self.health: HealthReport | None = None
        self.status = robot_status(Status(0), 0)
        self._samples, self._loops = Rate(), WrappingCounterRate(LOOPS_SPAN)

    def _take(self, event: Event, now_ns: int) -> bool:
        if isinstance(event, HelloReceived):
            self.code = "robot_link"
            self._wire.greeted()
            self._greeted_ns = now_ns
            self.send(self.dialogue.set_up(self._kept, now_ns), now_ns)
            self.send(self.dialogue.choose_signals(self._signals.selection, now_ns), now_ns)
        elif isinstance(event, SignalReport):
            self._signals.take(event, now_ns)
        elif isinstance(event, HealthReport):
            if self.health is None or event.error_code != self.health.error_code:
                bits = Status(0) if self.measured is None else self.measured.status
                self.status = robot_status(bits, event.error_code)
            self.health = event
            self._loops.read(event.loop_count, now_ns)
            self._set_up_again(event, now_ns)
        elif isinstance(event, PoseReport):
            self._pose = event
        elif self._pose is not None:
            if event.counter != self._pose.counter:
                raise RemoteProtocolError(
                    f"102 belongs to sample {event.counter}, the 101 before it to sample "
                    f"{self._pose.counter}: a packet is missing"
                )
            if self.measured is None or event.status != self.measured.status:
                error_code = 0 if self.health is None else self.health.error_code
                self.status = robot_status(event.status, error_code)
            self._samples.count(1, now_ns)
            self.measured = ControllerReport(
                T_base_flange=self._pose.T_base_flange,
                joint_rad=event.joint_rad,
                moving=bool(event.status & Status.MOVING),
                status=event.status,
                counter=event.counter,
                taken=self.dialogue.window.taken,
                at_ns=now_ns,
            )
            return True
        return False


def robot_status(status: Status, error_code: int) -> RobotStatus:
    """Return the status of any robot, with its faults, and the controller's own bits by name."""
    faults = tuple(
        _error(error_code) if bit == Status.ERROR else tripped(code, FAULTS[code].cause)
        for bit, (good, code) in FAULT_BITS.items()
        if bool(status & bit) != good
    )
    own = {name: bool(status & Status[name.upper()]) for name in CONTROLLER_BITS}
    return RobotStatus(
        ready=not faults,
        moving=bool(status & Status.MOVING),
        held=bool(status & Status.HELD),
        feedback=next((m for m, bits in MODES.items() if status & FEEDBACK_BITS == bits), None),
        faults=faults,
        kawasaki=KawasakiStatus(**own, error_code=error_code),
    )


def _error(error_code: int) -> Trip:
    """Return the fault of an error of AS; its code comes with the next 103, and is 0 before."""
    if error_code >= 0:
        return tripped("robot_error", FAULTS["robot_error"].cause)
    text = f"the controller reports {error_shown(error_code)}"
    return tripped("robot_error", text, value=error_code)

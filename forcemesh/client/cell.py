"""Client of a cell: blocking requests, and feeds of the topics."""

from collections.abc import Callable
from contextlib import ExitStack
from math import hypot
from pathlib import Path
from typing import Any, Self, TypeVar

from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.cell_info import CellInfo, ask_for_info
from forcemesh.client.ask import stopped_error
from forcemesh.client.contact import ContactEvents
from forcemesh.client.feed import Feed
from forcemesh.client.force import Force
from forcemesh.client.moves import Moves
from forcemesh.client.session import ClientSession
from forcemesh.client.signals import DigitalSignals
from forcemesh.clock import MonotonicClock, wait_until
from forcemesh.connection import Reachable, connection, read_connection
from forcemesh.errors import NotReachedError
from forcemesh.messages import (
    ArbiterStatus,
    ArmPurpose,
    Asker,
    Health,
    Message,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    SensorWrench,
    Speed,
    Trip,
    WrenchAtTcp,
)
from forcemesh.records import Record
from forcemesh.requests import (
    ArmRequest,
    BackOffRequest,
    CalibrationRequest,
    Empty,
    HoldRequest,
    Reply,
)
from forcemesh.schema import ask_for_description
from forcemesh.topics import CLIENT, Request, Topic
from forcemesh.zenoh_session import open_session
from forcemesh.zenoh_settings import certificate_name

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Record)

READY_WITHIN_S = 5.0  # the preflight needs one second of valid inputs at rest
SHOWN_WITHIN_S = 1.0  # longest time until arbiter/status shows a granted request
POLL_S = 0.01
WRENCH_WITHIN_S = 0.3
BACKED_OFF_S = 20.0  # its full travel, and time to come to rest before
BACKED_OFF = ("back_off", "still_loaded")


class Cell:
    """Client of one running cell. Every method may be called from any thread.

    The feeds are `Feed` objects: call one for the newest message, iterate for every message.
    """

    def __init__(
        self,
        cell: Path | str | Reachable,
        name: str | None = None,
        *,
        commander: Asker = "program",
        patience_s: float = 5.0,
        client: str = "",
        bus: Bus | None = None,
        info: CellInfo | None = None,
    ) -> None:
        """Connect.

        Args:
            cell: A cell file, of which only the sections `cell` and `bus` are read; or, with
                `name`, the endpoint of the hub, such as tcp/127.0.0.1:7447.
            name: Name of the cell at that endpoint.
            commander: Rank of motion requests: an `operator` preempts a program.
            patience_s: Longest wait for the hub [s].
            client: Name under which it owns force control, on a bus without certificates; default:
                a number drawn for this connection. With a certificate it is that one's name.
            bus: An open client bus, for instance in virtual time.
            info: Facts of the cell; default: those that its hub reports.

        Raises:
            ConfigError: The cell file, the endpoint or the name is wrong.
            BusError: No reply from a hub: the cell is not up, or it is another cell's hub.
        """
        reached = connection_of(cell, name)
        self._exits = ExitStack()
        try:
            if bus is None:
                transport = self._exits.enter_context(open_session(reached, CLIENT, patience_s))
                info = info or ask_for_info(transport, reached.cell)
                bus = Bus(CLIENT, reached.cell, transport, info, MonotonicClock())
                bus.client = certificate_name(reached) or client or bus.client
            self.info = info or ask_for_info(bus.transport, reached.cell)
        except BaseException:
            self._exits.close()
            raise
        self.session = session = ClientSession(bus, self.info, commander)
        self.state: Feed[RobotState] = session.feed(topics.ROBOT_STATE)
        self.wrench: Feed[WrenchAtTcp] = session.feed(topics.WRENCH)
        self.sensor: Feed[SensorWrench] = session.feed(topics.SENSOR_WRENCH)
        self.status: Feed[ArbiterStatus] = session.feed(topics.ARBITER_STATUS)
        self.target: Feed[RegulatorTarget] = session.feed(topics.REGULATOR_TARGET)
        self.command: Feed[RobotCommand] = session.feed(topics.ROBOT_COMMAND)
        self.move = Moves(session)
        self.jog = self.move.jog
        self.force = Force(session)
        self.signals = DigitalSignals(session)
        self.contact = ContactEvents(session)

    def __enter__(self) -> Self:
        """Return the client; it is closed on exit."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close; the arm continues with its last command."""
        self.close()

    def close(self) -> None:
        """Leave the bus."""
        self._exits.close()

    # --- who may move -----------------------------------------------------------------------------

    def arm(self, purpose: ArmPurpose = "all", *, within_s: float = READY_WITHIN_S) -> Reply:
        """Enable motion, after the preflight; for `jog` moves only, also in contact.

        Raises:
            RefusedError: The preflight still fails after `within_s`.
            ArmStoppedError: The arm was stopped again immediately.
        """
        reply = self.ask(topics.ARM, ArmRequest(purpose=purpose), within_s=within_s)
        if not self._shows(lambda status: status.operational):
            raise stopped_error(self.status(), "arming was granted, but")
        return reply

    def back_off(self, *, without_force: bool = False, timeout_s: float = BACKED_OFF_S) -> Trip:
        """Free an arm above a ceiling or outside the workspace, and wait until it holds again.

        The arbiter plans the path: along the measured force or straight back in, at most 20 mm
        at 5 mm/s. Returns the final trip: `back_off` when the arm is free.

        Args:
            without_force: Confirms 5 mm back along the tool when no force can be followed.
            timeout_s: Longest wait for the end [s]; then the arm is held.

        Raises:
            RefusedError: There is nothing to free, no force to follow, or the arm may move.
            ArmStoppedError: It was stopped before its end: the force rose, or a client held it.
            NotReachedError: It took too long.
        """
        request = BackOffRequest(without_force=without_force)
        self.ask(topics.BACK_OFF, request, within_s=READY_WITHIN_S)
        self._shows(lambda status: status.may_move)
        if not self._shows(lambda status: not status.may_move, timeout_s):
            self.hold("backing off took too long")
            raise NotReachedError(f"backing off took more than {timeout_s:g} s; the arm holds")
        status = self.status()
        end = next((trip for trip in status.trips if trip.code in BACKED_OFF), None)
        if end is None:
            raise stopped_error(status, "backing off was stopped")
        return end

    def hold(self, reason: str = "asked to hold") -> Reply:
        """Stop the motion and hold, for any commander. This is not a safety function."""
        return self.ask(topics.HOLD, HoldRequest(reason=reason[:400]))

    def clear(self) -> Reply:
        """Acknowledge a hold or a fault; arming is the next step."""
        reply = self.ask(topics.CLEAR, Empty())
        self._shows(lambda status: status.state not in ("HOLDING", "FAULT"))
        return reply

    # --- settings ---------------------------------------------------------------------------------

    def speed(
        self,
        *,
        mechanical_m_s: float | None = None,
        modular_fraction: float | None = None,
        accel_fraction: float | None = None,
        decel_fraction: float | None = None,
    ) -> Speed:
        """Set the speeds of the following moves and return them; omitted ones keep their values."""
        update = {
            "mechanical_m_s": mechanical_m_s,
            "modular_fraction": modular_fraction,
            "accel_fraction": accel_fraction,
            "decel_fraction": decel_fraction,
        }
        changes = {name: value for name, value in update.items() if value is not None}
        now = self.command().speed
        if not changes:
            return now
        speed = now.replaced(**changes)
        self.ask(topics.SPEED, speed)
        return speed

    def tare(self, *, within_s: float = 2.0) -> Reply:
        """Take the present reading as zero force; refused in motion or contact."""
        return self.ask(topics.TARE, Empty(), within_s=within_s)

    def calibrate(self, calibration_json: str, *, within_s: float = 3.0) -> Reply:
        """Use another calibration from now on; refused in motion or contact.

        Args:
            calibration_json: The calibration as `forcemesh calibrate` writes it, as JSON.
            within_s: So long to ask again while the arm moves.
        """
        request = CalibrationRequest(calibration_json=calibration_json)
        return self.ask(topics.CALIBRATE, request, within_s=within_s)

    # --- topics -----------------------------------------------------------------------------------

    def feed(self, topic: Topic[M]) -> Feed[M]:
        """Return the feed of a topic."""
        return self.session.feed(topic)

    def health(self, role: str) -> Feed[Health] | Feed[SensorWrench]:
        """Return the health feed of a role; for an external sensor the feed of its readings."""
        return self.session.roles.feeds[role]

    def silent(self) -> tuple[str, ...]:
        """Return the roles without messages; takes about a second the first time."""
        return self.session.roles.silent()

    def wait_ready(self, within_s: float = 20.0) -> ArbiterStatus:
        """Wait until arming would be granted, or the arm is armed already.

        Raises:
            NotValidError, LostError: As a feed.
            NotReachedError: Not ready within `within_s`; gives the reasons.
        """

        def is_ready(status: ArbiterStatus) -> bool:
            return status.operational or (status.state == "IDLE" and not status.not_ready)

        if not self._shows(is_ready, within_s):
            status = self.status()
            why = "; ".join([*status.not_ready, *(trip.text for trip in status.trips)])
            raise NotReachedError(f"not ready after {within_s:g} s, {status.state}: {why}")
        return self.status()

    def load_N(self) -> float | None:
        """Return the force on the tool [N] when it is loaded, None when it is free or unknown.

        Loaded means more than `force.touch_N`, in a wrench with a valid calibration.
        """
        wrench = self.wrench.wait(WRENCH_WITHIN_S).fresh
        if wrench is None or not wrench.calibrated:
            return None
        force_N = hypot(*wrench.force_N)
        return force_N if force_N > self.info.touch_N else None

    def describe(self) -> dict[str, Any]:
        """Return topics, requests and JSON Schema of this cell's bus, as published by its hub."""
        return ask_for_description(self.session.bus)

    # --- anything else ----------------------------------------------------------------------------

    def ask(self, request: Request[Q], message: Q, **options: Any) -> Reply:
        """Send any request of the table; options as in `Session.ask`."""
        return self.session.ask(request, message, **options)

    def _shows(
        self, condition: Callable[[ArbiterStatus], bool], within_s: float = SHOWN_WITHIN_S
    ) -> bool:
        """Wait until arbiter/status fulfils a condition; return whether it did."""

        def fulfils() -> bool:
            status = self.status.reading().fresh
            return status is not None and condition(status)

        return wait_until(self.session.clock, fulfils, within_s=within_s, poll_s=POLL_S)


def connection_of(cell: Path | str | Reachable, name: str | None) -> Reachable:
    """Return name and hub of a cell. Raise ConfigError when they are wrong."""
    if name is not None:
        return connection({"cell": name, "bus": {"endpoint": cell}}, "Cell(endpoint, name)")
    if isinstance(cell, (str, Path)):
        return read_connection(cell)
    return cell

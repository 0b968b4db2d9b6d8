"""A cell as a program sees it: short verbs that wait until they are done, and what is heard."""

from collections.abc import Callable
from contextlib import ExitStack
from math import hypot
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.cell_info import CellInfo, ask_for_info
from forcemesh.client.ask import stopped, well_formed
from forcemesh.client.feed import Feed
from forcemesh.client.force import Force
from forcemesh.client.moves import Moves
from forcemesh.client.session import Session
from forcemesh.clock import NS_PER_S, MonotonicClock
from forcemesh.connection import Reachable, connection, read_connection
from forcemesh.errors import NotReachedError
from forcemesh.messages import (
    ArbiterStatus,
    ArmPurpose,
    Asker,
    Health,
    Message,
    Record,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    SensorWrench,
    Speed,
    Trip,
    WrenchAtTcp,
)
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

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Record)

READY_WITHIN_S = 5.0  # the preflight wants a second of good inputs and rest
SHOWN_WITHIN_S = 1.0  # so long what was granted may take to show in arbiter/status
POLL_S = 0.01
HEARD_WITHIN_S = 0.3
BACKED_OFF_S = 20.0  # its longest way, and time to come to rest before
BACKED_OFF = ("back_off", "still_loaded")


class Cell:
    """One cell that is up. Every method may be called from any thread.

    Feeds, each a `Feed`: call it for the newest message, iterate for each one.
    """

    def __init__(
        self,
        cell: Path | str | Reachable,
        name: str | None = None,
        *,
        commander: Asker = "program",
        patience_s: float = 5.0,
        bus: Bus | None = None,
        info: CellInfo | None = None,
    ) -> None:
        """Connect.

        Args:
            cell: A cell file, of which `cell` and `bus` are read; or, with `name`, the endpoint of
                the hub, such as tcp/127.0.0.1:7447.
            name: Name of the cell at that endpoint.
            commander: Who asks for motion: a person (`operator`) takes the arm from a program.
            patience_s: Longest wait for the hub [s].
            bus: A client's bus that is open already, in virtual time for instance.
            info: Facts of the cell, where they are known; else the hub is asked for them.

        Raises:
            ConfigError: The cell file, the endpoint or the name is wrong.
            BusError: No hub answers: the cell is not up, or it is not the hub of this cell.
        """
        reached = connection_of(cell, name)
        self._exits = ExitStack()
        try:
            if bus is None:
                transport = self._exits.enter_context(open_session(reached, CLIENT, patience_s))
                info = info or ask_for_info(transport, reached.cell)
                bus = Bus(CLIENT, reached.cell, transport, info, MonotonicClock())
            self.info = info or ask_for_info(bus.transport, reached.cell)
        except BaseException:
            self._exits.close()
            raise
        self.session = session = Session(bus, self.info, commander)
        self.state: Feed[RobotState] = session.feed(topics.ROBOT_STATE)
        self.wrench: Feed[WrenchAtTcp] = session.feed(topics.WRENCH)
        self.sensor: Feed[SensorWrench] = session.feed(topics.SENSOR_WRENCH)
        self.status: Feed[ArbiterStatus] = session.feed(topics.ARBITER_STATUS)
        self.target: Feed[RegulatorTarget] = session.feed(topics.REGULATOR_TARGET)
        self.command: Feed[RobotCommand] = session.feed(topics.ROBOT_COMMAND)
        self.move = Moves(session)
        self.jog = self.move.jog
        self.force = Force(session)

    def __enter__(self) -> Self:
        """Be closed at the end."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close; the arm goes on with what it was told last."""
        self.close()

    def close(self) -> None:
        """Leave the bus."""
        self._exits.close()

    # --- who may move -----------------------------------------------------------------------------

    @well_formed()
    def arm(self, purpose: ArmPurpose = "all", *, within_s: float = READY_WITHIN_S) -> Reply:
        """Let motion begin, after the preflight; for `jog` moves alone, in contact as well.

        Raises:
            RefusedError: The preflight found something that `within_s` did not mend.
            ArmStoppedError: The arm was stopped again at once.
        """
        reply = self.ask(topics.ARM, ArmRequest(purpose=purpose), within_s=within_s)
        if not self._shows(lambda status: status.goes_on):
            raise stopped(self.status(), "arming was granted, but")
        return reply

    def back_off(self, *, without_force: bool = False, timeout_s: float = BACKED_OFF_S) -> Trip:
        """Free an arm above a ceiling or outside the workspace, and wait until it holds again.

        The arbiter computes the way: along the measured force or straight back in, at most 20 mm
        at 5 mm/s. Returns how it ended: `back_off` when the arm is free.

        Args:
            without_force: Confirms 5 mm back along the tool, where no force can be followed.
            timeout_s: Longest wait for its end [s]; then the arm is held.

        Raises:
            RefusedError: There is nothing to free, no force to follow, or the arm may move.
            ArmStoppedError: It was stopped on its way: the force rose, somebody held it.
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
            raise stopped(status, "backing off was stopped")
        return end

    def hold(self, reason: str = "asked to hold") -> Reply:
        """Stop the motion and hold, whoever commands. This is not a safety function."""
        return self.ask(topics.HOLD, HoldRequest(reason=reason[:400]))

    def clear(self) -> Reply:
        """Acknowledge a hold or a fault; arming is the next step."""
        reply = self.ask(topics.CLEAR, Empty())
        self._shows(lambda status: status.state not in ("HOLDING", "FAULT"))
        return reply

    # --- settings ---------------------------------------------------------------------------------

    @well_formed()
    def speed(
        self,
        *,
        mechanical_m_s: float | None = None,
        modular_fraction: float | None = None,
        accel_fraction: float | None = None,
        decel_fraction: float | None = None,
    ) -> Speed:
        """Set the speeds of the moves to come and return them; what is left out keeps its value."""
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
        wanted = Speed.model_validate({**now.model_dump(), **changes})
        self.ask(topics.SPEED, wanted)
        return wanted

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

    # --- what is heard ----------------------------------------------------------------------------

    def feed(self, topic: Topic[M]) -> Feed[M]:
        """Return the feed of any topic of the table."""
        return self.session.feed(topic)

    def health(self, role: str) -> Feed[Health] | Feed[SensorWrench]:
        """Return the feed that shows whether a role is alive; of a foreign sensor its readings."""
        return self.session.roles.feeds[role]

    def silent(self) -> tuple[str, ...]:
        """Return the roles that are not heard; takes a second or so the first time."""
        return self.session.roles.silent()

    def wait_ready(self, within_s: float = 20.0) -> ArbiterStatus:
        """Wait until arming would be granted, or the arm is armed already.

        Raises:
            NotValidError, LostError: As a feed does.
            NotReachedError: It is not ready within `within_s`; says why.
        """
        if not self._shows(lambda s: s.goes_on or _is_ready(s), within_s):
            status = self.status()
            why = "; ".join([*status.not_ready, *(trip.text for trip in status.trips)])
            raise NotReachedError(f"not ready after {within_s:g} s, {status.state}: {why}")
        return self.status()

    def load_N(self) -> float | None:
        """Return the force on the tool [N] when it is loaded, None where it is free or not known.

        Loaded is more than `force.touch_N` of the cell file; the calibration in use must be valid.
        """
        clock = self.session.clock
        give_up_ns = clock.now_ns() + round(HEARD_WITHIN_S * NS_PER_S)
        while (wrench := self.wrench.reading().fresh) is None and clock.now_ns() < give_up_ns:
            clock.sleep_s(POLL_S)
        if wrench is None or not wrench.calibrated:
            return None
        force_N = hypot(*wrench.force_N)
        return force_N if force_N > self.info.touch_N else None

    def describe(self) -> dict[str, Any]:
        """Return what is said on this cell's bus, with JSON Schema, as its hub tells it."""
        return ask_for_description(self.session.bus)

    # --- anything else ----------------------------------------------------------------------------

    def ask(self, request: Request[Q], message: Q, **options: Any) -> Reply:
        """Ask for anything of the table of requests; options as `Session.ask`."""
        return self.session.ask(request, message, **options)

    def _shows(
        self, wanted: Callable[[ArbiterStatus], bool], within_s: float = SHOWN_WITHIN_S
    ) -> bool:
        """Wait until arbiter/status says so; tell whether it did."""
        clock = self.session.clock
        give_up_ns = clock.now_ns() + round(within_s * NS_PER_S)
        while True:
            status = self.status.reading().fresh
            if status is not None and wanted(status):
                return True
            if clock.now_ns() >= give_up_ns:
                return False
            clock.sleep_s(POLL_S)


def _is_ready(status: ArbiterStatus) -> bool:
    return status.state == "IDLE" and not status.not_ready


def connection_of(cell: Path | str | Reachable, name: str | None) -> Reachable:
    """Return name and hub of a cell. Raise ConfigError when they are wrong."""
    if name is not None:
        return connection({"cell": name, "bus": {"endpoint": cell}}, "Cell(endpoint, name)")
    if isinstance(cell, (str, Path)):
        return read_connection(cell)
    return cell

"""Arbiter service: all inputs in, permission and command out."""

from collections.abc import Callable
from typing import Any

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus, Inbox
from forcemesh.clock import NS_PER_S
from forcemesh.messages import ArbiterState, Trip
from forcemesh.requests import Reply
from services.arbiter.core import FIRST_NUMBERS, Arbiter
from services.arbiter.inputs import Inputs
from services.arbiter.monitors import InputMonitors


class ArbiterService:
    """Service that passes on one commander's motion, and publishes the reason when it does not."""

    def __init__(
        self, bus: Bus, cell: CellConfig, *, numbers: tuple[int, int] = FIRST_NUMBERS
    ) -> None:
        """Open the topics and requests of this role.

        Args:
            bus: Bus of the cell.
            cell: The cell.
            numbers: Lease and ownership number of before, in a replay; a process starts with 0.
        """
        self.period_s = 1.0 / cell.rates.control_hz
        self.fault = ""
        deadline_s = cell.stale_after_s(topics.ROBOT_COMMAND)
        core = Arbiter(cell, command_deadline_s=deadline_s, numbers=numbers)
        self._core = core
        self._watch = InputMonitors(cell)
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._sensor = bus.reader(topics.SENSOR_WRENCH)
        self._wrench = bus.reader(topics.WRENCH)
        self._target = bus.reader(topics.REGULATOR_TARGET)
        without_health = {"arbiter", "sensor"} if cell.roles.sensor == "external" else {"arbiter"}
        watched = [role for role in topics.ROLES if role not in without_health]
        self._health = {role: bus.reader(topics.HEALTH[role]) for role in watched}
        self._command = bus.publisher(topics.ROBOT_COMMAND)
        self._status = bus.publisher(topics.ARBITER_STATUS)
        self._status_period_ns = round(NS_PER_S / cell.rates.status_hz)
        self._next_status_ns = 0
        self._published: tuple[ArbiterState, tuple[Trip, ...]] = ("BOOT", ())
        self._requests: tuple[tuple[Inbox[Any], Callable[[Any, Inputs], Reply]], ...] = (
            (bus.inbox(topics.CLEAR), lambda _, inputs: core.clear(inputs)),
            (bus.inbox(topics.ARM), lambda arm, inputs: core.arm(inputs, arm.purpose)),
            (
                bus.inbox(topics.BACK_OFF),
                lambda back_off, inputs: core.back_off(inputs, confirmed=back_off.without_force),
            ),
            (bus.inbox(topics.SPEED), lambda speed, _: core.set_speed(speed)),
            (bus.inbox(topics.MOVE), core.move),
            # Last, so that no other request of the same period can undo it.
            (bus.inbox(topics.HOLD), lambda hold, _: core.hold(hold.reason)),
        )
        self.trigger = self._target

    def counters(self) -> dict[str, int]:
        """Return the number of targets superseded before they were read."""
        return {"target_superseded": self._target.counters.superseded}

    def step(self, now_ns: int) -> None:
        """Serve requests, check the inputs, publish command and status, reply."""
        inputs = Inputs(
            now_ns=now_ns,
            robot=self._robot.read(now_ns),
            sensor=self._sensor.read(now_ns),
            wrench=self._wrench.read(now_ns),
            target=self._target.read(now_ns),
            health={role: reader.read(now_ns) for role, reader in self._health.items()},
        )
        self._watch.update(inputs)
        answers = [
            (incoming, answer(incoming.request, inputs))
            for inbox, answer in self._requests
            for incoming in inbox.take_all()
        ]
        self._command.put(self._core.tick(inputs), inputs.target.origin)
        # At its rate, and at once when the state or a cause changes.
        report = (self._core.state, self._core.trips)
        if now_ns >= self._next_status_ns or report != self._published:
            self._next_status_ns, self._published = now_ns + self._status_period_ns, report
            self._status.put(self._core.status())
        # Last, so that the status is published before a client acts on the reply.
        for incoming, reply in answers:
            incoming.reply(reply)

    def broke_off(self, trip: Trip) -> None:
        """End motion: an exception left this service's state undefined."""
        self._core.stop("fault", trip)

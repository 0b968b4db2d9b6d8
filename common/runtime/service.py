"""Runner of services: the same object in its own process or in a cell on a virtual clock.

A service runs on its trigger (a newer message of its main input), on its period, or on both, so
that it always publishes. Each step reads a snapshot, computes and publishes.
"""

import argparse
import os
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import cell_hash, load_cell
from common.runtime.heartbeat import heartbeat_of_this_process
from common.runtime.overruns import Overruns, allowed_gap_s
from common.runtime.realtime import (
    ProcessorAccount,
    bind_to_cores,
    give_up_realtime_priority,
    has_realtime_priority,
    is_memory_locked,
    prepare_realtime,
)
from common.runtime.stop import StopSignal, stop_on_signals
from forcemesh.bus import Bus, Reader
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.errors import ConfigError, ForcemeshError
from forcemesh.faults import clipped, tripped
from forcemesh.messages import Health, Trip
from forcemesh.topics import HEALTH
from forcemesh.version import __version__
from forcemesh.zenoh_settings import use_one_thread

LONGEST_PAUSE_S = 0.05  # longer waits would delay the stop of the process
PATIENCE_PERIODS = 1.5  # a triggered service without input steps after this many periods
LATENESS_WINDOW = 512
BREAKDOWN_SHOWN_NS = 2 * NS_PER_S  # after the last error: longer than the health period


class Service(Protocol):
    """Interface of a service for the runner."""

    @property
    def period_s(self) -> float:
        """Longest time between steps [s]."""

    @property
    def trigger(self) -> Reader[Any] | None:
        """Input whose newer messages trigger a step."""

    @property
    def fault(self) -> str:
        """Present fault of this service, empty when there is none."""

    def step(self, now_ns: int) -> None:
        """Read, compute, publish."""

    def counters(self) -> dict[str, int]:
        """Return the counters for the health message."""


@runtime_checkable
class Scheduled(Protocol):
    """A service that says itself when it must step next; its trigger adds steps in between."""

    @property
    def due_ns(self) -> int:
        """Time of the next step."""


@runtime_checkable
class Closable(Protocol):
    """A service with a clean-up at its end."""

    def close(self) -> None:
        """Release resources."""


@runtime_checkable
class HasNumbers(Protocol):
    """A service that publishes measured numbers in its health."""

    def numbers(self, now_ns: int) -> dict[str, float]:
        """Return the numbers, units in the names."""


@runtime_checkable
class Metered(Protocol):
    """A transport that measures the duration of its puts."""

    def longest_put_s(self, since_ns: int) -> float:
        """Return the duration of the longest put that began after a monotonic time [s]."""


Connect = Callable[[CellConfig, str], AbstractContextManager[Bus]]


@runtime_checkable
class Stoppable(Protocol):
    """A service that must stop the arm itself when its step raises an error."""

    def broke_off(self, trip: Trip) -> None:
        """Latch the trip."""


class HealthReporter:
    """Publisher of the health of a bus's role, from the role's own loop."""

    def __init__(
        self,
        bus: Bus,
        cell: CellConfig,
        account: ProcessorAccount | None = None,
        *,
        is_first: bool = True,
    ) -> None:
        """Prepare the constant fields.

        Args:
            bus: Of the role.
            cell: The cell.
            account: Of the role's loop; the first role of a loop has it.
            is_first: Of the roles of a process: this one publishes the share of the processor.
        """
        self._transport = bus.transport
        self._bus = bus
        self._publisher = bus.publisher(HEALTH[bus.role])
        self._period_ns = round(NS_PER_S / cell.rates.health_hz)
        self._next_ns = 0
        self._steps = 0
        self._since_ns = bus.clock.now_ns()
        self._lateness_s: deque[float] = deque(maxlen=LATENESS_WINDOW)
        self._overruns = Overruns(allowed_gap_s(cell, bus.role))
        self._account, self._late_cause, self._is_first = account, "", is_first
        self._config_hash = cell_hash(cell)
        self._breakdown = ""

    def begins(self) -> None:
        """Note the beginning of a step."""
        if self._account is not None:
            self._account.begins()

    def stepped(
        self, now_ns: int, lateness_s: float, service: Service, breakdown: str = ""
    ) -> None:
        """Count a step; publish health when due, or at once after an error.

        Args:
            now_ns: Present time.
            lateness_s: Lateness of the step [s].
            service: The service.
            breakdown: Error of a step in the last seconds, empty when there is none.
        """
        if breakdown and not self._breakdown:
            self._next_ns = now_ns
        self._breakdown = breakdown
        self._steps += 1
        self._lateness_s.append(lateness_s)
        self._overruns.stepped(now_ns)
        if self._account is not None and self._overruns.is_late:
            self._late_cause = self._account.cause_of(self._overruns.gap_s)
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + self._period_ns
        elapsed_s = max(now_ns - self._since_ns, 1) / NS_PER_S
        late = sorted(self._lateness_s)
        counters = {
            "realtime": int(has_realtime_priority()),
            "memory_locked": int(is_memory_locked()),
        }
        if (served := self._bus.requests_served) is not None:
            counters["requests"] = served
        numbers = service.numbers(now_ns) if isinstance(service, HasNumbers) else {}
        if isinstance(self._transport, Metered):  # the longest put since the last report
            numbers = {**numbers, "put_max_s": self._transport.longest_put_s(self._since_ns)}
        if self._account is not None:
            fraction = self._account.fraction()  # also begins its next count of waiting
            if self._is_first:
                numbers = {**numbers, "processor_fraction": fraction}
        self._publisher.put(
            Health(
                valid=not breakdown,
                reason=breakdown,
                code="internal" if breakdown else "",
                pid=os.getpid(),
                rate_hz=self._steps / elapsed_s,
                lateness_p99_s=late[int(0.99 * (len(late) - 1))],
                overruns=self._overruns.count,
                longest_gap_s=self._overruns.longest_s,
                late_cause=self._late_cause if self._overruns.count else "",
                counters={**counters, **service.counters()},
                numbers=numbers,
                fault=breakdown or service.fault,
                version=__version__,
                config_hash=self._config_hash,
            )
        )
        self._steps, self._since_ns = 0, now_ns


class Containment:
    """Error containment: turns an exception of a step into a fault; the process survives.

    The aborted step publishes nothing more, so that its readers detect it as stale; its health
    reports `internal` at once and long enough to be seen. Later steps are executed: a recurring
    error keeps the fault, otherwise a person can clear it.
    """

    def __init__(self, role: str, write: Callable[[str], object] = sys.stderr.write) -> None:
        """Contain errors of a role; `say` writes to its log."""
        self.breakdowns = 0
        self._role, self._write = role, write
        self._text, self._until_ns, self._write_ns = "", 0, 0

    def step(self, service: Service, now_ns: int) -> str:
        """Step a service; return the error of a step in the last seconds, empty when none."""
        try:
            service.step(now_ns)
        except Exception as error:  # noqa: BLE001 - for any error, a silent exit is worse
            self._broke_off(service, error, now_ns)
        return self._text if now_ns < self._until_ns else ""

    def _broke_off(self, service: Service, error: Exception, now_ns: int) -> None:
        self.breakdowns += 1
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        self._text = clipped(f"{self._role}: {type(error).__name__} at {where}: {error}")
        self._until_ns = now_ns + BREAKDOWN_SHOWN_NS
        if now_ns >= self._write_ns:  # at most once a second
            self._write_ns = now_ns + NS_PER_S
            trace = "".join(traceback.format_exception(error))
            self._write(f"{self._role}: unexpected error ({self.breakdowns} so far)\n{trace}")
        if isinstance(service, Stoppable):
            service.broke_off(tripped("internal", self._text))


class Runner:
    """Scheduler of one service: decides when it is due and steps it."""

    def __init__(
        self,
        service: Service,
        reporters: list[HealthReporter],
        clock: Clock,
        *,
        contain: Containment | None = None,
    ) -> None:
        """Make the service due at once; without a containment exceptions propagate."""
        self.service = service
        self._reporters = reporters
        self._clock = clock
        self._contain = contain
        self.fault = ""
        self._trigger = service.trigger
        self._scheduled = service if isinstance(service, Scheduled) else None
        self._period_ns = round(service.period_s * NS_PER_S)
        self._patience_ns = round(PATIENCE_PERIODS * self._period_ns)
        self.due_ns = clock.now_ns()

    def step(self, now_ns: int) -> bool:
        """Step once if the trigger has fired or the period has elapsed; return whether it has.

        A missed step is not repeated.
        """
        has_fired = self._trigger is not None and self._trigger.poll()
        if not has_fired and now_ns < self.due_ns:
            return False
        lateness_s = max(0, now_ns - self.due_ns) / NS_PER_S
        for reporter in self._reporters:
            reporter.begins()
        if self._contain is None:
            self.service.step(now_ns)
            breakdown = ""
        else:
            breakdown = self._contain.step(self.service, now_ns)
        self.fault = breakdown or self.service.fault
        if self._scheduled is not None:  # a step that broke off has not moved it on
            self.due_ns = now_ns + self._period_ns if breakdown else self._scheduled.due_ns
        elif self._trigger is None:
            self.due_ns = max(self.due_ns + self._period_ns, now_ns - self._period_ns)
        else:
            self.due_ns = now_ns + self._patience_ns
        for reporter in self._reporters:
            reporter.stepped(now_ns, lateness_s, self.service, breakdown)
        return True

    def run(self, stop: StopSignal, then: Sequence["Runner"] = ()) -> None:
        """Step whenever due until stopped; write a heartbeat for the container's health check.

        Args:
            stop: Ends it.
            then: Services of the same process whose trigger this one publishes: each steps after
                the one before it.
        """
        heartbeat = heartbeat_of_this_process()
        pause = self._clock.sleep_s if self._trigger is None else self._trigger.wait
        chain = (self, *then)
        while not stop.is_set():
            now_ns, has_stepped = self._clock.now_ns(), False
            for runner in chain:
                if runner.step(now_ns):
                    has_stepped, now_ns = True, self._clock.now_ns()
            if has_stepped:
                heartbeat.beat(now_ns, next((each.fault for each in chain if each.fault), ""))
            if (left_s := (min(each.due_ns for each in chain) - now_ns) / NS_PER_S) > 0.0:
                pause(min(left_s, LONGEST_PAUSE_S))


def main(
    roles: str | tuple[str, ...],
    make_service: Callable[[Bus, CellConfig], Service],
    *,
    implementation: str | None = None,
    connect: Connect = open_bus,
    realtime: bool = True,
) -> None:
    """Run one service as a process until SIGTERM or SIGINT.

    Args:
        roles: The role of the process, or several; the first one opens the bus.
        make_service: Factory of the service; if it has a `close`, that is called at the end.
        implementation: Its name in the cell file, for roles with several of them. A cell
            file with another implementation is refused.
        connect: Connects to the bus; the hub opens it instead.
        realtime: Whether to use real-time priority; a helper does not.
    """
    roles = (roles,) if isinstance(roles, str) else roles
    cell = cell_from_arguments(roles[0])
    with exit_on_error(roles[0]):
        if implementation is not None:
            for role in roles:
                refuse_other_implementation(cell, role, implementation)
        run_process(cell, {roles: make_service}, connect=connect, realtime=realtime)


def run_process(
    cell: CellConfig,
    services: Mapping[tuple[str, ...], Callable[[Bus, CellConfig], Service]],
    *,
    connect: Connect = open_bus,
    realtime: bool = True,
) -> None:
    """Run services on one connection until SIGTERM or SIGINT; as `main`, with each one's roles."""
    stop, (first, *_), runners = stop_on_signals(), next(iter(services)), list[Runner]()
    with ExitStack() as exits:
        if first in cell.cores:
            bind_to_cores(cell.cores[first])
        use_one_thread()
        bus = exits.enter_context(connect(cell, first))
        exits.callback(give_up_realtime_priority)
        for (role, *others), make_service in services.items():
            own = bus if role == first else bus.playing(role)
            service = make_service(own, cell)
            if isinstance(service, Closable):
                exits.callback(service.close)
            reporters = [HealthReporter(own, cell, ProcessorAccount(), is_first=not runners)]
            reporters += [HealthReporter(bus.playing(other), cell) for other in others]
            runners.append(Runner(service, reporters, bus.clock, contain=Containment(role)))
        if realtime:
            prepare_realtime()
        runners[0].run(stop, runners[1:])


def refuse_other_implementation(cell: CellConfig, role: str, implementation: str) -> None:
    """Prevent two processes from running one role.

    Raises:
        ConfigError: The cell file names another one than `implementation`.
    """
    chosen = getattr(cell.roles, role)
    if chosen != implementation:
        mistake = (
            f"roles.{role} is {chosen}, but this process is the {implementation}: "
            f"start the {chosen}, or write `{role}: {implementation}` in the cell file"
        )
        raise ConfigError(f"cell {cell.cell}", [mistake])


def cell_from_arguments(role: str) -> CellConfig:
    """Read the cell file named on the command line; exit and list its mistakes if any."""
    parser = argparse.ArgumentParser(prog=role, description=f"The {role} of a forcemesh cell.")
    parser.add_argument("--cell", required=True, metavar="FILE", help="the cell file")
    with exit_on_error(role):
        return load_cell(parser.parse_args().cell)


@contextmanager
def exit_on_error(role: str) -> Iterator[None]:
    """End the process with one line on standard error and code 2 on an error of forcemesh."""
    try:
        yield
    except ForcemeshError as error:
        sys.stderr.write(f"{role}: {error}\n")
        raise SystemExit(2) from error

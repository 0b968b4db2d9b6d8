"""The process around a service: its start, its triggers, its end, its reports, its errors."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.runtime import realtime
from common.runtime import service as process
from common.runtime.realtime import ProcessorAccount
from common.runtime.service import (
    BREAKDOWN_SHOWN_NS,
    LONGEST_PAUSE_S,
    PATIENCE_PERIODS,
    Containment,
    HealthReporter,
    Runner,
    cell_from_arguments,
)
from common.runtime.stop import StopSignal
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.errors import BusError
from forcemesh.messages import Health, Trip
from tests.fakes.bench import CELL
from tests.fakes.lab import Lab

DEMO_FILE = Path(__file__).resolve().parents[4] / "cells" / "demo.yaml"
MS = 1_000_000


class Worker:
    """A service without a trigger that notes when it steps, and breaks off if it shall."""

    fault = ""
    trigger: Any = None

    def __init__(self, clock: ManualClock, *, period_s: float = 0.2) -> None:
        """Step now and then."""
        self.period_s = period_s
        self.steps_ns: list[int] = []
        self.error: Exception | None = None
        self._clock = clock

    def step(self, now_ns: int) -> None:
        """Note it."""
        self.steps_ns.append(now_ns)
        if self.error is not None:
            raise self.error

    def counters(self) -> dict[str, int]:
        """There are no counters."""
        return {}


class LastStep(Worker):
    """A service during whose third step the process is asked to end, by a signal."""

    asked_by = signal.SIGTERM

    def step(self, now_ns: int) -> None:
        """Receive the signal to end."""
        super().step(now_ns)
        if len(self.steps_ns) == 3:
            signal.raise_signal(self.asked_by)


def worker_of(worker: Worker, *_: object) -> Worker:
    """Return a service that is made already."""
    return worker


class ServiceBus:
    """One cell's bus in memory, as a process opens it."""

    def __init__(self) -> None:
        """Start without a client."""
        self.clock, self.transport = ManualClock(), MemoryTransport()
        self.opened_by: list[str] = []

    def bus(self, role: str) -> Bus:
        """Return the bus as a role has it."""
        return Bus(role, CELL.cell, self.transport, CELL, self.clock)

    @contextmanager
    def connect(self, _cell: CellConfig, role: str) -> Iterator[Bus]:
        """Open it as a process does."""
        self.opened_by.append(role)
        yield self.bus(role)


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[ServiceBus]:
    """A bus, the demo cell on the command line, and signals as they were afterwards."""
    monkeypatch.setattr("sys.argv", ["role", "--cell", str(DEMO_FILE)])
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield ServiceBus()
    for number, handler in before.items():
        signal.signal(number, handler)


# --- start and end --------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_process_that_is_asked_to_end_finishes_its_step_and_no_other(
    line: ServiceBus, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A helper has no real-time priority; of two roles the health of both is published."""
    monkeypatch.setattr(process, "prepare_realtime", lambda: pytest.fail("of a helper"))
    worker = LastStep(line.clock)
    worker.asked_by = number
    roles, client = ("robot", "sensor"), line.bus(topics.CLIENT)
    readers = [client.reader(topics.HEALTH[role]) for role in roles]
    process.main(
        roles, lambda *_: worker, connect=line.connect, implementation="sim", realtime=False
    )
    assert len(worker.steps_ns) == 3
    assert line.opened_by == ["robot"]
    assert all(reader.read(line.clock.now_ns()).fresh for reader in readers)


def test_roles_of_one_process_have_one_connection_and_a_health_each(line: ServiceBus) -> None:
    """The first one's health has the processor time of all; each names the causes of its delays."""
    workers = {"wrench": LastStep(line.clock), "regulator": Worker(line.clock)}
    client = line.bus(topics.CLIENT)
    readers = [client.reader(topics.HEALTH[role]) for role in workers]
    process.run_process(
        CELL,
        {(role,): partial(worker_of, each) for role, each in workers.items()},
        connect=line.connect,
        realtime=False,
    )
    assert line.opened_by == ["wrench"]
    assert [len(each.steps_ns) for each in workers.values()] == [3, 3]
    first, then = [reader.read(line.clock.now_ns()).message for reader in readers]
    assert first is not None
    assert then is not None
    assert "processor_fraction" in first.numbers
    assert "processor_fraction" not in then.numbers


def test_a_role_that_the_cell_gives_to_another_process_is_never_played(
    line: ServiceBus, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two robots on one bus would be two arms: exit 2 before the bus is open, with the remedy."""
    for roles in ("robot", ("sensor", "robot")):
        with pytest.raises(SystemExit, match="2"):
            process.main(roles, lambda *_: pytest.fail("made"), connect=line.connect,
                         implementation="gateway", realtime=False)  # fmt: skip
        assert line.opened_by == []
        assert ": gateway` in the cell file\n" in capsys.readouterr().err


@pytest.mark.usefixtures("line")
def test_the_cell_that_the_command_line_names_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """That one and no other; with mistakes in it, all are printed and nothing runs."""
    assert cell_from_arguments("arbiter") == CELL
    monkeypatch.setattr("sys.argv", ["arbiter"])
    with pytest.raises(SystemExit, match="2"):
        cell_from_arguments("arbiter")
    broken = tmp_path / "broken.yaml"
    broken.write_text("cell: demo\nspeeed: 3\nroles: {robot: sim}\n", encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["arbiter", "--cell", str(broken)])
    with pytest.raises(SystemExit, match="2"):
        cell_from_arguments("arbiter")
    printed = capsys.readouterr().err
    assert "speeed" in printed
    assert "roles.sensor" in printed


# --- what wakes it --------------------------------------------------------------------------------


class Trigger:
    """A main input on a virtual clock: messages come at given times, and waiting ends with one."""

    def __init__(self, clock: ManualClock, comes_ms: list[int]) -> None:
        """Remember when they come, from now on."""
        self._clock, start_ns = clock, clock.now_ns()
        self._comes_ns = [start_ns + at * MS for at in comes_ms]
        self.waits_s: list[float] = []

    def poll(self) -> bool:
        """Return whether one has come since the last call."""
        came = [at for at in self._comes_ns if at <= self._clock.now_ns()]
        self._comes_ns = self._comes_ns[len(came) :]
        return bool(came)

    def wait(self, timeout_s: float) -> None:
        """Let time pass until the next one, at most so long."""
        self.waits_s.append(timeout_s)
        end_ns = self._clock.now_ns() + max(1, round(timeout_s * 1e9))
        next_ns = min([end_ns, *self._comes_ns])
        self._clock.advance_ns(next_ns - self._clock.now_ns())


def run_until(worker: Worker, clock: ManualClock, steps: int) -> list[int]:
    """Run a service for so many steps; return when they were, from the start on [ms]."""
    stop, start_ns = StopSignal(), clock.now_ns()
    whole = worker.step

    def step(now_ns: int) -> None:
        whole(now_ns)
        if len(worker.steps_ns) == steps:
            stop.set()

    worker.step = step  # type: ignore[method-assign]
    Runner(worker, [], clock).run(stop)
    return [round((at - start_ns) / MS) for at in worker.steps_ns]


def test_a_service_without_a_trigger_steps_once_a_period() -> None:
    """On the beat, whatever is between; it checks every 50 ms whether it shall end."""
    clock = ManualClock()
    pauses_s: list[float] = []
    sleep_s = clock.sleep_s

    def slept(duration_s: float) -> None:
        pauses_s.append(duration_s)
        sleep_s(duration_s)

    clock.sleep_s = slept  # type: ignore[method-assign]
    assert run_until(Worker(clock, period_s=0.2), clock, 4) == [0, 200, 400, 600]
    assert max(pauses_s) <= LONGEST_PAUSE_S


def test_a_newer_message_wakes_its_service_and_silence_does_so_too() -> None:
    """A message: at once. None: after one and a half periods, or a dead input stayed unsaid."""
    clock = ManualClock()
    worker = Worker(clock, period_s=0.1)
    worker.trigger = trigger = Trigger(clock, [30, 70])
    patience_ms = round(1e3 * PATIENCE_PERIODS * 0.1)
    assert run_until(worker, clock, 5) == [0, 30, 70, 70 + patience_ms, 70 + 2 * patience_ms]
    assert max(trigger.waits_s) <= LONGEST_PAUSE_S


def test_services_of_one_process_step_one_after_the_other() -> None:
    """The next takes what the first has published, before the process sleeps again."""
    clock, stop, steps = ManualClock(), StopSignal(), list[tuple[str, int]]()
    start_ns = clock.now_ns()
    first, then = Worker(clock, period_s=0.1), Worker(clock, period_s=0.1)
    first.trigger, arrived = Trigger(clock, [30, 70]), Trigger(clock, [])
    then.trigger = arrived

    def note(name: str, now_ns: int) -> None:
        steps.append((name, round((now_ns - start_ns) / MS)))
        if name == "first" and len(steps) > 2:
            arrived._comes_ns.append(now_ns)
        if len(steps) == 6:
            stop.set()

    for name, worker in (("first", first), ("then", then)):
        worker.step = partial(note, name)  # type: ignore[method-assign]
    Runner(first, [], clock).run(stop, [Runner(then, [], clock)])
    assert steps == [
        ("first", 0),
        ("then", 0),
        ("first", 30),
        ("then", 30),
        ("first", 70),
        ("then", 70),
    ]


class SlowWorker(Worker):
    """A service whose steps take a time."""

    busy_s = 0.3

    def step(self, now_ns: int) -> None:
        """Take it."""
        super().step(now_ns)
        self._clock.sleep_s(self.busy_s)


def test_a_service_that_is_late_steps_again_at_once() -> None:
    """Without a pause, and without making up for all that it missed in a stall."""
    clock = ManualClock()
    assert run_until(SlowWorker(clock, period_s=0.1), clock, 3) == [0, 300, 600]
    runner, stalled_ns = Runner(Worker(clock, period_s=0.1), [], clock), clock.now_ns() + 1000 * MS
    assert runner.step(clock.now_ns())
    assert [runner.step(stalled_ns) for _ in range(5)] == [True, True, True, False, False]


# --- its health -----------------------------------------------------------------------------------


class MeteredTransport(MemoryTransport):
    """A bus that knows how long its puts take."""

    def longest_put_s(self, since_ns: int) -> float:
        """Return the requested age, so that a test can check the request."""
        return since_ns / 1e9


class MeasuringWorker(Worker):
    """A service that measures something."""

    def numbers(self, now_ns: int) -> dict[str, float]:
        """Return the measured numbers."""
        return {"age_s": (now_ns - self.steps_ns[0]) / 1e9}


class FailingWorker(Worker):
    """A service that stops the arm itself when it breaks off."""

    def __init__(self, clock: ManualClock) -> None:
        """Start well."""
        super().__init__(clock, period_s=0.004)
        self.trips: list[Trip] = []

    def broke_off(self, trip: Trip) -> None:
        """Remember."""
        self.trips.append(trip)


class Reported:
    """A service with its runner, and a client that reads its health."""

    def __init__(
        self,
        worker: Worker,
        clock: ManualClock,
        transport: MemoryTransport,
        account: ProcessorAccount | None = None,
    ) -> None:
        """Contain its errors in a log."""
        self.log: list[str] = []
        self._clock = clock
        self.bus = Bus("wrench", CELL.cell, transport, CELL, clock)
        client = Bus(topics.CLIENT, CELL.cell, transport, CELL, clock)
        self._reader = client.reader(topics.HEALTH["wrench"])
        contain = Containment("wrench", self.log.append)
        self._runner = Runner(
            worker, [HealthReporter(self.bus, CELL, account)], clock, contain=contain
        )

    def after(self, duration_s: float) -> Health:
        """Step after a time; return the last health."""
        self._clock.sleep_s(duration_s)
        self._runner.step(self._clock.now_ns())
        message = self._reader.read(self._clock.now_ns()).message
        assert message is not None
        return message


@pytest.mark.parametrize("is_locked", [True, False])
def test_health_reports_the_numbers_of_the_service_and_the_longest_put(
    monkeypatch: pytest.MonkeyPatch, is_locked: bool
) -> None:
    """Since the health before, and nothing where the bus does not know; also locked memory."""
    monkeypatch.setattr(realtime, "_locked", is_locked)
    clock = ManualClock()
    reported = Reported(MeasuringWorker(clock, period_s=0.1), clock, MeteredTransport())
    numbers = [reported.after(0.1).numbers for _ in range(10)][::3]
    assert [each["age_s"] for each in numbers] == pytest.approx([0.0, 0.3, 0.6, 0.9])
    assert [each["put_max_s"] for each in numbers] == pytest.approx([1.0, 1.1, 1.4, 1.7])
    clock = ManualClock()
    reported = Reported(Worker(clock, period_s=0.1), clock, MemoryTransport())
    health = reported.after(0.0)
    assert (health.numbers, health.counters.get("requests")) == ({}, None)
    reported.bus.inbox(topics.TARE)
    counters = reported.after(0.3).counters
    assert (counters["requests"], counters["memory_locked"]) == (0, is_locked)


@pytest.mark.parametrize("error", [RecursionError("deep"), BusError("x")], ids=repr)
def test_an_unforeseen_error_is_reported_at_once_and_the_process_continues(
    error: Exception,
) -> None:
    """Health names it in the same step; two seconds after the last one it is well again."""
    clock = ManualClock()
    failing = FailingWorker(clock)
    reported = Reported(failing, clock, MemoryTransport())
    assert reported.after(0.004).valid
    failing.error = error
    report = reported.after(0.004)
    assert (report.valid, report.code) == (False, "internal")
    assert report.reason == report.fault
    assert report.reason.startswith(f"wrench: {type(error).__name__} at test_service.py:")
    for _ in range(100):
        reported.after(0.004)
    assert len(failing.steps_ns) == 102
    assert len(reported.log) == 1, "one trace a second, however often it comes"
    assert "Traceback" in reported.log[0]
    assert {trip.code for trip in failing.trips} == {"internal"}
    failing.error = None
    assert reported.after(BREAKDOWN_SHOWN_NS / 1e9).valid


@pytest.mark.parametrize("role", ["arbiter", "regulator", "wrench", "robot"])
def test_a_pressing_arm_holds_when_a_step_of_any_service_breaks_off(
    role: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One error in one step of a whole cell: FAULT, and nothing moves before a person arms."""
    lab = Lab()
    lab.approach()
    runner = lab.cell.runners[role]
    runner._contain = Containment(role, lambda _text: None)
    step, left = runner.service.step, [1]

    def once(now_ns: int) -> None:
        if left:
            left.pop()
            raise OverflowError("cannot convert float infinity to integer")
        step(now_ns)

    monkeypatch.setattr(runner.service, "step", once)
    lab.cell.advance(0.06)
    assert lab.status.state == "FAULT"
    assert lab.status.trips[-1].code == "internal"
    assert "OverflowError" in lab.status.trips[-1].text
    lab.cell.advance(0.25)
    lab.assert_still(0.3)

"""The process around a service: its start, its triggers, its end, its reports."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.runtime import service as process
from common.runtime.service import (
    LONGEST_PAUSE_S,
    PATIENCE_PERIODS,
    Containment,
    HealthReporter,
    Runner,
    cell_from_arguments,
    exit_on_error,
)
from common.runtime.stop import StopSignal, stop_on_signals
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.errors import BusError, ForcemeshError
from forcemesh.messages import Health, SensorWrench
from tests.fakes.bench import CELL

DEMO_FILE = Path(__file__).resolve().parents[4] / "cells" / "demo.yaml"


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
    line: ServiceBus, number: signal.Signals
) -> None:
    """Both signals; nothing is raised, and a service without a goodbye needs none."""
    worker = LastStep(line.clock)
    worker.asked_by = number
    process.main(
        "robot", lambda *_: worker, connect=line.connect, implementation="sim", realtime=False
    )
    assert len(worker.steps_ns) == 3
    assert line.opened_by == ["robot"]


def test_a_service_that_has_a_goodbye_sends_it_before_the_bus_is_left(line: ServiceBus) -> None:
    """A gateway sends its controller a hold: it needs its wire for that, and its topics."""

    class Leaving(LastStep):
        def close(self) -> None:
            line.opened_by.append("goodbye")

    @contextmanager
    def connect(_cell: CellConfig, role: str) -> Iterator[Bus]:
        yield line.bus(role)
        line.opened_by.append("left")

    process.main("wrench", lambda *_: Leaving(line.clock), connect=connect, realtime=False)
    assert line.opened_by == ["goodbye", "left"]


@pytest.mark.parametrize("realtime", [True, False])
def test_only_loops_that_move_the_arm_get_real_time_priority(
    line: ServiceBus, realtime: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A helper that was given real-time priority would take it from the loops."""
    spared: list[int] = []
    worker = LastStep(line.clock)
    monkeypatch.setattr(process, "prepare_realtime", lambda: spared.append(len(worker.steps_ns)))
    process.main("recorder", lambda *_: worker, connect=line.connect, realtime=realtime)
    assert spared == ([0] if realtime else [])


def test_a_process_of_two_roles_gives_the_health_of_both(line: ServiceBus) -> None:
    """The first role's bus is opened; the second one plays on it."""
    readers = [
        line.bus(topics.CLIENT).reader(topic)
        for topic in (topics.HEALTH["robot"], topics.HEALTH["sensor"])
    ]
    roles, worker = ("robot", "sensor"), LastStep(line.clock)
    process.main(
        roles, lambda *_: worker, connect=line.connect, implementation="sim", realtime=False
    )
    assert line.opened_by == ["robot"]
    assert [bool(reader.read(line.clock.now_ns()).fresh) for reader in readers] == [True, True]


@pytest.mark.parametrize("roles", ["robot", ("sensor", "robot")])
def test_a_role_that_the_cell_gives_to_another_process_is_never_played(
    line: ServiceBus, roles: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two robots on one bus would be two arms: exit 2 before the bus is open, with the remedy."""

    def make(*_: object) -> Worker:
        raise AssertionError("made")

    with pytest.raises(SystemExit) as ended:
        process.main(roles, make, connect=line.connect, implementation="gateway", realtime=False)
    printed = capsys.readouterr().err
    assert ended.value.code == 2
    assert line.opened_by == []
    assert printed.count("\n") == len(printed.splitlines())
    assert "gateway" in printed
    assert "in the cell file" in printed


def test_a_bus_that_does_not_open_ends_the_process_with_one_line(
    line: ServiceBus, capsys: pytest.CaptureFixture[str]
) -> None:
    """The operator reads what is wrong, not a trace."""

    @contextmanager
    def no_hub(_cell: CellConfig, _role: str) -> Iterator[Bus]:
        raise BusError("no hub answers")
        yield

    with pytest.raises(SystemExit) as ended:
        process.main("wrench", lambda *_: Worker(line.clock), connect=no_hub, realtime=False)
    assert ended.value.code == 2
    assert capsys.readouterr().err == "wrench: no hub answers\n"


@pytest.mark.parametrize("error", [KeyError("x"), KeyboardInterrupt()], ids=repr)
def test_an_error_outside_of_forcemesh_ends_the_process_with_its_trace(
    error: BaseException,
) -> None:
    """An unforeseen error at start is a bug: it must not read as a mistake of the user."""
    with pytest.raises(type(error)), exit_on_error("wrench"):
        raise error


def test_a_success_is_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    """No output, and no exit."""
    with exit_on_error("wrench"):
        pass
    assert capsys.readouterr().err == ""


# --- the command line -----------------------------------------------------------------------------


def test_the_cell_that_the_command_line_names_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """That one and no other: `--cell` has no default."""
    monkeypatch.setattr("sys.argv", ["arbiter", "--cell", str(DEMO_FILE)])
    assert cell_from_arguments("arbiter") == CELL
    monkeypatch.setattr("sys.argv", ["arbiter"])
    with pytest.raises(SystemExit) as ended:
        cell_from_arguments("arbiter")
    assert ended.value.code == 2


def test_a_cell_file_with_mistakes_ends_the_process_and_all_of_them_are_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No service runs with the half that could be read."""
    broken = tmp_path / "broken.yaml"
    broken.write_text("cell: demo\nspeeed: 3\nroles: {robot: sim}\n", encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["arbiter", "--cell", str(broken)])
    with pytest.raises(SystemExit) as ended:
        cell_from_arguments("arbiter")
    printed = capsys.readouterr().err
    assert ended.value.code == 2
    assert printed.startswith("arbiter: ")
    assert "speeed" in printed
    assert "roles.sensor" in printed


def test_a_signal_only_sets_the_event(line: ServiceBus) -> None:
    """The handler does nothing that a step in the middle of its work could notice."""
    assert line.opened_by == []
    stop = stop_on_signals()
    assert not stop.is_set()
    signal.raise_signal(signal.SIGTERM)
    assert stop.is_set()


# --- what wakes it --------------------------------------------------------------------------------


class Trigger:
    """A main input on a virtual clock: messages come at given times, and waiting ends with one."""

    def __init__(self, clock: ManualClock, comes_ns: list[int]) -> None:
        """Remember when they come."""
        self._clock, self._comes_ns = clock, comes_ns
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


MS = 1_000_000


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
    start_ns = clock.now_ns()
    worker.trigger = trigger = Trigger(clock, [start_ns + at * MS for at in (30, 70)])
    patience_ms = round(1e3 * PATIENCE_PERIODS * 0.1)
    assert run_until(worker, clock, 5) == [0, 30, 70, 70 + patience_ms, 70 + 2 * patience_ms]
    assert max(trigger.waits_s) <= LONGEST_PAUSE_S


class ScheduledWorker(Worker):
    """A service that is due every 100 ms, 30 ms after its start."""

    def __init__(self, clock: ManualClock) -> None:
        """Keep the grid of the start."""
        super().__init__(clock, period_s=0.1)
        self._start_ns = clock.now_ns()

    @property
    def due_ns(self) -> int:
        """The next of its times after the last step."""
        last_ns = (self.steps_ns or [self._start_ns])[-1] - self._start_ns
        periods = (last_ns // MS + 70) // 100
        return self._start_ns + (30 + 100 * periods) * MS


def test_a_scheduled_service_steps_at_its_own_times_and_on_messages() -> None:
    """A message makes one step more; the next one is when the service says."""
    clock = ManualClock()
    worker = ScheduledWorker(clock)
    start_ns = clock.now_ns()
    worker.trigger = Trigger(clock, [start_ns + at * MS for at in (50, 170)])
    assert run_until(worker, clock, 7) == [0, 30, 50, 130, 170, 230, 330]


def test_a_scheduled_service_that_breaks_off_is_due_after_a_period() -> None:
    """It did not come to its next time, and would be stepped without a pause."""
    clock = ManualClock()
    worker = ScheduledWorker(clock)
    worker.error = ValueError("broken")
    start_ns = clock.now_ns()
    containment = Containment("robot", lambda text: None)
    runner = Runner(worker, [], clock, contain=containment)
    assert runner.step(start_ns)
    assert not runner.step(start_ns + 99 * MS)
    assert runner.step(start_ns + 100 * MS)


class SlowWorker(Worker):
    """A service whose steps take longer than its period."""

    def step(self, now_ns: int) -> None:
        """Take three periods."""
        super().step(now_ns)
        self._clock.sleep_s(3.0 * self.period_s)


def test_a_service_that_is_late_steps_again_at_once() -> None:
    """Without a pause, and without making up for what it missed."""
    clock = ManualClock()
    assert run_until(SlowWorker(clock, period_s=0.1), clock, 3) == [0, 300, 600]


def test_a_message_wakes_the_service() -> None:
    """The service's own reader is the trigger: one step for all that waits, and none without."""
    line = ServiceBus()
    worker = Worker(line.clock, period_s=10.0)
    worker.trigger = line.bus("wrench").reader(topics.SENSOR_WRENCH)
    sensor = line.bus("sensor").publisher(topics.SENSOR_WRENCH)
    runner = Runner(worker, [], line.clock)
    assert runner.step(line.clock.now_ns())
    assert not runner.step(line.clock.now_ns())
    for counter in range(3):
        sensor.put(SensorWrench(counter=counter))
    assert runner.step(line.clock.now_ns())
    assert not runner.step(line.clock.now_ns())


# --- its own health report ------------------------------------------------------------------------


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


def healths(worker: Worker, transport: MemoryTransport, clock: ManualClock) -> list[Health]:
    """Let a service work for a second; return all health that it gave."""
    bus = Bus("wrench", CELL.cell, transport, CELL, clock)
    reader = Bus(topics.CLIENT, CELL.cell, transport, CELL, clock).reader(topics.HEALTH["wrench"])
    runner, reports = Runner(worker, [HealthReporter(bus, CELL)], clock), []
    for _ in range(10):
        runner.step(clock.now_ns())
        if reader.poll():
            message = reader.read(clock.now_ns()).message
            assert message is not None
            reports.append(message)
        clock.sleep_s(0.1)
    return reports


def test_health_reports_the_numbers_of_the_service_and_the_longest_put() -> None:
    """The longest put since the health before, and nothing where the bus does not know."""
    clock = ManualClock()
    reports = healths(MeasuringWorker(clock, period_s=0.1), MeteredTransport(), clock)
    times = [message.numbers for message in reports]
    assert [entry["age_s"] for entry in times] == pytest.approx([0.0, 0.3, 0.6, 0.9])
    assert [entry["put_max_s"] for entry in times] == pytest.approx([1.0, 1.0, 1.3, 1.6])
    clock = ManualClock()
    assert healths(Worker(clock, period_s=0.1), MemoryTransport(), clock)[-1].numbers == {}


def test_a_service_that_cannot_stop_the_arm_is_contained_as_well() -> None:
    """Its health reports it, and the arbiter stops the arm for it."""
    line = ServiceBus()
    worker = Worker(line.clock, period_s=0.1)
    worker.error = ForcemeshError("worn out")
    contain = Containment("wrench", lambda _: None)
    assert "ForcemeshError" in contain.step(worker, line.clock.now_ns())
    assert (len(worker.steps_ns), contain.breakdowns) == (1, 1)

"""Regression replay of services: recorded inputs and requests go in, the output is compared.

The services run in this process on the clock of the recording. Several of them are coupled: each
receives what the others publish now.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

from typer import Exit

from cli.context import NOT_WELL, exit_with_error, waiting
from cli.replay_differences import Differences, Published, compared
from cli.replay_parts import (
    NEVER_NS,
    PLACES,
    REPLAYED_ROLES,
    RecordedPart,
    SeededBus,
    Step,
    recorded_part,
    topics_written_by,
)
from common.bus.memory_bus import MemoryCall, MemoryTransport
from common.config.cell import CellConfig
from common.runtime.service import Containment, Service
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import DataError
from forcemesh.recorded_messages import readdressed
from forcemesh.served_requests import request_data
from forcemesh.topics import TOPICS
from services.recorder.reading import RecordedBytes, RecordedFile

CELL_ROLES = ("regulator", "arbiter")  # of `--to-service cell`
SERVICE_QUEUE = 10_000  # messages of one topic in one step


def replay_to_service(read: RecordedFile, cell: CellConfig, named: str) -> None:
    """Play a recording through services, print the differences of their output.

    Ends with an exit code that is not zero when there is a difference.
    """
    roles = CELL_ROLES if named == "cell" else tuple(dict.fromkeys(named.split(",")))
    if unknown := [role for role in roles if role not in REPLAYED_ROLES]:
        choices = f"{', '.join(REPLAYED_ROLES)}, several of them with commas, or cell"
        exit_with_error(f"--to-service {','.join(unknown)}: it must be one of {choices}")
    with waiting(f"feeding {', '.join(roles)}"):
        messages = list(read.raw_messages())
        if not messages:
            exit_with_error(f"{read.path}: the recording contains no message")
        try:
            parts = [recorded_part(messages, role) for role in roles]
            replays = replayed(messages, parts, cell)
            found = [compared(part, replays[part.role], messages[0].at_ns) for part in parts]
        except DataError as error:
            raise DataError(f"{read.path}: {error}") from error
    for part, differences in zip(parts, found, strict=True):
        _print_part(part, differences, messages[0].at_ns)
    if any(differences.count for differences in found):
        raise Exit(NOT_WELL)


def _print_part(part: RecordedPart, differences: Differences, first_ns: int) -> None:
    requests = sum(len(step.requests) for step in part.steps)
    counts = f"{len(part.steps)} steps and {requests} requests"
    begin_s = (part.begin_ns - first_ns) / NS_PER_S
    compared_s = (part.compared_ns - first_ns) / NS_PER_S
    since = "its start" if part.state is None else f"compared from {compared_s:.3f} s on"
    print(f"{part.role}: {counts} from {begin_s:.3f} s: {since}")
    for note in dict.fromkeys(part.notes):
        print(f"  note: {note}")
    for line in differences.lines():
        print(f"  {line}")


class ReplayEvent(NamedTuple):
    """Input, start or step, in the order of time."""

    at_ns: int
    place: int  # at one time: in the order of the signal path
    act: Callable[[], None]


class ReplayedPart:
    """Service that is replayed, on its own clock."""

    def __init__(self, part: RecordedPart, cell: CellConfig, transport: MemoryTransport) -> None:
        """Prepare the bus of the service; `start` makes it."""
        header = part.own[0].header
        self.recorded, self.published = part, Published()
        self._cell, self._transport = cell, transport
        self._clock = ManualClock(part.begin_ns - part.offset_ns, boot=header.boot)
        self._bus = SeededBus(
            part.role, cell.cell, transport, cell, self._clock, header.epoch,
            first_seq=part.first_seq(),
        )  # fmt: skip
        self._taps = {
            topic.key: transport.subscribe(f"{cell.cell}/{topic.key}", SERVICE_QUEUE)
            for topic in topics_written_by(part.role)
        }
        self._service: Service
        self._contained = Containment(part.role)

    def start(self) -> None:
        """Start the service: it receives what is published from now on."""
        self._service = REPLAYED_ROLES[self.recorded.role].make(
            self._bus, self._cell, self.recorded
        )

    def step(self, number: int) -> None:
        """Execute a recorded step; keep what is published."""
        step = self.recorded.steps[number]
        now_ns = step.at_ns - self.recorded.offset_ns
        self._clock.advance_ns(max(now_ns - self._clock.now_ns(), 0))
        self._ask(step)
        self._contained.step(self._service, now_ns)
        counts: Counter[str] = Counter()
        for key, tap in self._taps.items():
            while (data := tap.take()) is not None:
                self.published[key, number, counts[key]] = data
                counts[key] += 1

    def _ask(self, step: Step) -> None:
        """Queue the requests that were served in a step."""
        for served in step.requests:
            address = f"{self._cell.cell}/{served.request}"
            try:
                data = request_data(served, address, self._clock)
            except DataError as error:
                self.recorded.notes.append(f"not replayed: {error}")
                continue
            self._transport.serve(address).waiting.append(MemoryCall(data))


def replayed(
    messages: list[RecordedBytes], parts: list[RecordedPart], cell: CellConfig
) -> dict[str, Published]:
    """Return what each role publishes when it receives recorded inputs and requests.

    What a replayed role published itself is not taken from the recording, from its first step on.
    """
    transport = MemoryTransport()
    made = [ReplayedPart(part, cell, transport) for part in parts]
    for part in made:
        if part.recorded.state is not None:  # it has received the inputs before its first step, too
            part.start()
    for *_, act in sorted([*_inputs(messages, parts, cell, transport), *_steps(made)], key=_order):
        act()
    return {part.recorded.role: part.published for part in made}


def _order(event: ReplayEvent) -> tuple[int, int]:
    return event.at_ns, event.place


def _steps(parts: list[ReplayedPart]) -> Iterator[ReplayEvent]:
    for part in parts:
        recorded = part.recorded
        if recorded.state is None:
            yield ReplayEvent(recorded.begin_ns, -1, part.start)
        for number, step in enumerate(recorded.steps):
            yield ReplayEvent(step.read_ns, step.place, partial(part.step, number))


def _inputs(
    messages: list[RecordedBytes],
    parts: list[RecordedPart],
    cell: CellConfig,
    transport: MemoryTransport,
) -> Iterator[ReplayEvent]:
    roles = {part.role for part in parts}
    puts = {
        topic.key: transport.publish(f"{cell.cell}/{topic.key}", topic.qos)
        for topic in TOPICS
        if roles & set(topic.readers)
    }
    begins = {topic.key: part.begin_ns for part in parts for topic in topics_written_by(part.role)}
    for each in messages:
        if each.topic in puts and each.at_ns < begins.get(each.topic, NEVER_NS):
            data = readdressed(each.data, f"{cell.cell}/{each.topic}")
            yield ReplayEvent(each.at_ns, PLACES[each.topic], partial(puts[each.topic], data))

"""Regression replay of one service: recorded inputs go in, its outputs are compared.

The service runs in this process on the clock of the recording. Requests are not recorded: their
effect shows as a difference.
"""

from collections.abc import Callable, Iterable
from itertools import groupby
from typing import Any

from cli.context import exit_with_error, waiting
from cli.recording_tables import flat_fields
from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.runtime.service import HealthReporter, Runner, Service
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import Header
from forcemesh.messages import Message
from forcemesh.recorded_messages import decode_recorded, readdressed
from forcemesh.topics import TOPICS, Topic
from services.arbiter.service import ArbiterService
from services.recorder.reading import RecordedBytes, RecordedFile
from services.regulator.service import Regulator
from services.wrench.service import WrenchService

REPLAY_TICK_NS = 1_000_000
SETTLES_NS = NS_PER_S  # filters start empty
SERVICE_QUEUE = 1_000_000
Published = list[tuple[Header, Message]]


def replay_to_service(read: "RecordedFile", cell: "CellConfig", role: str) -> None:
    """Feed a service and print the differences of its output."""
    makers: dict[str, Callable[[Bus, Any], Service]] = {
        "wrench": WrenchService,
        "regulator": Regulator,
        "arbiter": ArbiterService,
    }
    if role not in makers:
        exit_with_error(f"--to-service {role}: it must be one of {', '.join(makers)}")
    with waiting(f"feeding {role}"):
        messages = list(read.raw_messages())
        if not messages:
            exit_with_error(f"{read.path}: the recording contains no message")
        output = service_output(messages, cell, role, make=makers[role], about=read.about)
    for topic in topics_written_by(role):
        data = (each.data for each in messages if each.topic == topic.key)
        recorded = _decoded_messages(data, topic)
        pairs = message_pairs(recorded, output[topic.key])
        print(f"{topic.key}: {len(output[topic.key])} published, {len(recorded)} recorded")
        print(f"  {len(pairs)} compared, without the first second")
        for name, largest in field_differences(pairs).items():
            print(f"  {name}: {largest}")


def topics_written_by(role: str) -> list[Topic[Any]]:
    """Return the streams of a role, without its health, which describes the process."""
    return [topic for topic in TOPICS if topic.writer == role and not topic.key.endswith("health")]


def service_output(
    messages: "list[RecordedBytes]",
    cell: "CellConfig",
    role: str,
    *,
    make: Callable[[Bus, Any], Service],
    about: dict[str, str],
) -> dict[str, Published]:
    """Return the output of a service by topic when it receives the messages in their time.

    It starts at its first message in the recording, so that its cycles are in phase.
    """
    offset_ns = int(about["wall_minus_monotonic_ns"])
    written = {topic.key: topic for topic in topics_written_by(role)}
    begin_ns = next((each.at_ns for each in messages if each.topic in written), messages[0].at_ns)
    clock = ManualClock(begin_ns - offset_ns, boot=about["clock"])
    transport = MemoryTransport()
    bus = Bus(role, cell.cell, transport, cell, clock)
    taps = {key: transport.subscribe(f"{cell.cell}/{key}", SERVICE_QUEUE) for key in written}
    runner = Runner(make(bus, cell), [HealthReporter(bus, cell)], clock)
    keys = [topic.key for topic in TOPICS if role in topic.readers]
    publishers = {key: transport.publish(f"{cell.cell}/{key}", "report") for key in keys}
    replayed = (each for each in messages if each.topic in publishers and each.at_ns >= begin_ns)
    for at_ns, batch in groupby(replayed, key=lambda each: each.at_ns - offset_ns):
        while at_ns - clock.now_ns() > REPLAY_TICK_NS:
            clock.advance_ns(REPLAY_TICK_NS)
            runner.step(clock.now_ns())
        clock.advance_ns(max(at_ns - clock.now_ns(), 0))
        for each in batch:
            publishers[each.topic](readdressed(each.data, f"{cell.cell}/{each.topic}"))
        runner.step(clock.now_ns())
    return {
        key: _decoded_messages(iter(taps[key].take, None), topic) for key, topic in written.items()
    }


def message_pairs(recorded: Published, published: Published) -> list[tuple[Message, Message]]:
    """Return pairs of messages about the same sensor sample, else those nearest in time."""
    if not recorded or not published:
        return []
    begin_ns = published[0][0].stamp_ns + SETTLES_NS
    late = [(header, message) for header, message in published if header.stamp_ns >= begin_ns]
    by_sample = {h.sensor_seq: message for h, message in recorded if h.sensor_seq is not None}
    if by_sample:
        return [(by_sample[h.sensor_seq], m) for h, m in late if h.sensor_seq in by_sample]
    pairs, at = [], 0
    for header, message in late:
        while at + 1 < len(recorded) and recorded[at + 1][0].stamp_ns <= header.stamp_ns:
            at += 1
        pairs.append((recorded[at][1], message))
    return pairs


def field_differences(pairs: list[tuple[Message, Message]]) -> dict[str, str]:
    """Return for each differing field the largest difference, or the number of messages."""
    numbers: dict[str, float] = {}
    counts: dict[str, int] = {}
    for recorded, replayed in pairs:
        then, now = (dict(flat_fields(each.as_dict())) for each in (recorded, replayed))
        for name in dict.fromkeys((*then, *now)):
            a, b = then.get(name), now.get(name)
            if isinstance(a, float) and isinstance(b, float):
                numbers[name] = max(numbers.get(name, 0.0), abs(a - b))
            elif a != b:
                counts[name] = counts.get(name, 0) + 1
    found = {
        name: f"differs by at most {largest:.3g}" for name, largest in numbers.items() if largest
    }
    found |= {name: f"differs in {count} messages" for name, count in counts.items()}
    return found or {"all fields": "equal"}


def _decoded_messages(data: Iterable[bytes], topic: Topic[Any]) -> Published:
    return [decode_recorded(each, topic.message, topic.key) for each in data]

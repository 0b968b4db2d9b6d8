"""Playback of a recording on a bus: the same messages, in the same order and timing.

The bytes are the same except for the address, if the cell has another name now or the recording is
of an older schema version.
"""

from collections.abc import Callable, Iterable, Iterator

from forcemesh.bus import Transport
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.recorded_messages import readdressed
from forcemesh.topics import TOPICS
from services.recorder.reading import RecordedBytes

QOS = {topic.key: topic.qos for topic in TOPICS}


def chosen(messages: Iterable[RecordedBytes], only: frozenset[str]) -> Iterator[RecordedBytes]:
    """Yield the messages of the named topics, of all if none is named."""
    return (each for each in messages if not only or each.topic in only)


def play(
    messages: Iterable[RecordedBytes],
    transport: Transport,
    cell: str,
    *,
    clock: Clock,
    speed: float = 1.0,
    shown: Callable[[int, float], None] = lambda _count, _at_s: None,
) -> int:
    """Publish messages on the bus of a cell at their times; return how many.

    Args:
        messages: The messages in the order of time.
        transport: Transport to publish on.
        cell: Name of the cell, prefix of the keys.
        clock: Clock of the playback.
        speed: Factor on the original speed; infinite: as fast as possible.
        shown: Called after each message with their number and the recorded time [s].
    """
    puts: dict[str, Callable[[bytes], None]] = {}
    began_ns, first_ns, count = clock.now_ns(), 0, 0
    for count, each in enumerate(messages, start=1):
        first_ns = first_ns or each.at_ns
        due_ns = began_ns + round((each.at_ns - first_ns) / speed)
        if (early_ns := due_ns - clock.now_ns()) > 0:
            clock.sleep_s(early_ns / NS_PER_S)
        if each.topic not in puts:
            puts[each.topic] = transport.publish(
                f"{cell}/{each.topic}", QOS.get(each.topic, "report")
            )
        puts[each.topic](readdressed(each.data, f"{cell}/{each.topic}"))
        shown(count, (each.at_ns - first_ns) / NS_PER_S)
    return count

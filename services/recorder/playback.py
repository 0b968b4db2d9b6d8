"""Publishes a recording on a bus again: the same messages, in the same order, in its time.

They are the same bytes, but for the address where the cell has another name now, or the recording
is of an older schema version.
"""

from collections.abc import Callable, Iterable, Iterator

from forcemesh.bus import Transport
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.codec import readdressed
from forcemesh.topics import TOPICS
from services.recorder.reading import Heard

QOS = {topic.key: topic.qos for topic in TOPICS}


def chosen(heard: Iterable[Heard], only: frozenset[str]) -> Iterator[Heard]:
    """Yield the messages of some topics, of all when none is named."""
    return (each for each in heard if not only or each.topic in only)


def play(
    heard: Iterable[Heard],
    transport: Transport,
    cell: str,
    *,
    clock: Clock,
    speed: float = 1.0,
    shown: Callable[[int, float], None] = lambda _count, _at_s: None,
) -> int:
    """Put messages on the bus of a cell when their time has come; return how many.

    Args:
        heard: The messages in the order of time.
        transport: Where they go.
        cell: The name before their keys.
        clock: Whose time passes meanwhile.
        speed: Times the original one; infinite: as fast as it goes.
        shown: Is told after each message how many there were, and how far in [s].
    """
    puts: dict[str, Callable[[bytes], None]] = {}
    began_ns, first_ns, count = clock.now_ns(), 0, 0
    for count, each in enumerate(heard, start=1):
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

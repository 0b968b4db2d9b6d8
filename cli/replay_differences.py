"""Comparison of what a replayed service publishes with what its process published."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from cli.recording_tables import flat_fields, shortened
from cli.replay_parts import ENDS_NS, Recorded, RecordedPart
from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError
from forcemesh.recorded_messages import decode_recorded
from forcemesh.topics import TOPICS

PublishedKey = tuple[str, int, int]  # topic, step, number of the message within the step
Published = dict[PublishedKey, bytes]

# Fields of the process, which are not compared. All of them are equal on a virtual clock.
OF_PROCESS = {
    "stamp_ns": "a process takes time between reading and publishing, a replay none",
    "received_ns": "the same, of a request",
    "seq": "a message too many or too few is a difference of its own, not of all later ones",
    "v": "an older recording has another schema version",
    "topic": "the address in an older recording has no cell",
}
FIRST_SHOWN = 5  # first differences that are printed
LONGEST_VALUE = 80
ABSENT = "not published"
MESSAGE_TYPES = {topic.key: topic.message for topic in TOPICS}


class Difference(NamedTuple):
    """One field that differs, or a message that only one side has."""

    at_ns: int
    topic: str
    name: str
    recorded: Any
    now: Any

    def line(self, first_ns: int) -> str:
        """Return it as text, with the time since the first message of the recording."""
        at_s = (self.at_ns - first_ns) / NS_PER_S
        before, now = (shortened(each, LONGEST_VALUE) for each in (self.recorded, self.now))
        return f"{at_s:.3f} s {self.topic} {self.name}: recorded {before}, now {now}"


@dataclass(slots=True)
class Differences:
    """Result of the comparison of one role."""

    first_ns: int
    totals: dict[str, Counter[str]] = field(default_factory=dict)  # by topic
    found: list[Difference] = field(default_factory=list)

    @property
    def count(self) -> int:
        """The number of fields and messages that differ."""
        return len(self.found)

    def lines(self) -> list[str]:
        """Return a summary of each topic, and the first differences."""
        lines = []
        for topic, total in self.totals.items():
            equal = f"{total['bytes']} equal byte for byte, {total['fields']} in all fields"
            counts = f"{total['recorded']} recorded, {total['now']} now"
            lines.append(f"{topic}: {counts}: {equal}, {total['differ']} differ")
            fields = [each for each in self.found if each.topic == topic]
            lines += [f"  {name}: {text}" for name, text in field_differences(fields).items()]
        ordered = sorted(self.found, key=lambda each: each.at_ns)
        if ordered:
            lines.append("first differences:")
            lines += [f"  {each.line(self.first_ns)}" for each in ordered[:FIRST_SHOWN]]
        return lines


def compared(part: RecordedPart, published: Published, first_ns: int) -> Differences:
    """Compare what a role publishes now with the recording, message by message of each step.

    Args:
        part: The role in the recording.
        published: What it publishes now.
        first_ns: Wall clock time of the first message of the recording.

    Raises:
        DataError: There is nothing to compare.
    """
    result = Differences(first_ns, {key: Counter() for key in part.compared_topics()})
    recorded = _by_step(part)
    for key in sorted({*recorded, *published}, key=lambda each: each[1:]):
        topic, number, _ = key
        before, data = recorded.get(key), published.get(key)
        at_ns = part.steps[number].at_ns if before is None else before.at_ns
        if topic not in result.totals or not part.compared_ns <= at_ns <= part.until_ns:
            continue
        total = result.totals[topic]
        total["recorded"] += before is not None
        total["now"] += data is not None
        if before is not None and data == before.data:
            total["bytes"] += 1
            continue
        differences = _fields(at_ns, topic, before, data)
        total["differ" if differences else "fields"] += 1
        result.found += differences
    if not any(total["recorded"] for total in result.totals.values()):
        raise DataError(
            f"the recording is too short: the output of {part.role} is compared from "
            f"{(part.compared_ns - part.begin_ns) / NS_PER_S:g} s after the first moment at which "
            f"its state is known until {ENDS_NS / NS_PER_S:g} s before the end"
        )
    return result


def field_differences(found: list[Difference]) -> dict[str, str]:
    """Return for each differing field the largest difference, or the number of messages."""
    numbers: dict[str, float] = {}
    counts: Counter[str] = Counter()
    for each in found:
        if isinstance(each.recorded, float) and isinstance(each.now, float):
            numbers[each.name] = max(numbers.get(each.name, 0.0), abs(each.recorded - each.now))
        else:
            counts[each.name] += 1
    texts = {name: f"differs by at most {largest:.3g}" for name, largest in numbers.items()}
    return texts | {name: f"differs in {count} messages" for name, count in counts.items()}


def _by_step(part: RecordedPart) -> dict[PublishedKey, Recorded]:
    counts: Counter[tuple[str, int]] = Counter()
    found: dict[PublishedKey, Recorded] = {}
    for each in part.own:
        place = each.topic, part.step_of(each)
        found[*place, counts[place]] = each
        counts[place] += 1
    return found


def _fields(
    at_ns: int, topic: str, before: Recorded | None, data: bytes | None
) -> list[Difference]:
    """Return the fields that differ, without those of the process."""
    if before is None:
        return [Difference(at_ns, topic, "message", ABSENT, "published")]
    if data is None:
        return [Difference(at_ns, topic, "message", "published", ABSENT)]
    header, message = decode_recorded(data, MESSAGE_TYPES[topic], topic)
    then = dict(flat_fields(before.header.as_dict() | before.message.as_dict()))
    now = dict(flat_fields(header.as_dict() | message.as_dict()))
    names = [name for name in dict.fromkeys((*then, *now)) if name not in OF_PROCESS]
    return [
        Difference(at_ns, topic, name, then.get(name), now.get(name))
        for name in names
        if then.get(name) != now.get(name)
    ]

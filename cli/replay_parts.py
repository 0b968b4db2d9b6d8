"""Service of a recording, played again: its known start, its recorded steps, and what it published.

A process reads, computes and publishes in one step, and the recording has the time of publication.
So the replayed service steps at these times. Before a step it receives the recorded inputs that
were published before, without those that are newer than the sample which its output names, and the
requests that the process took from its queue in that step.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

from common.config.cell import CellConfig
from common.runtime.service import Service
from forcemesh import topics
from forcemesh.bus import Bus, Publisher
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.errors import DataError, MessageError
from forcemesh.messages import ArbiterStatus, ContactEvent, Health, Message
from forcemesh.recorded_messages import decode_recorded
from forcemesh.requests import ServedRequest
from forcemesh.topics import HEALTH, HELPERS, ROLES, TOPICS, Topic
from services.arbiter.service import ArbiterService
from services.recorder.reading import RecordedBytes
from services.regulator.service import STOPPED, Regulator
from services.wrench.service import WrenchService

NEVER_NS = 2**63
# Filters and monitors that begin within a recording start empty; arming needs a second of inputs.
SETTLES_NS = 3 * NS_PER_S // 2
# The recorder reads one topic after another: outputs of the end may lack the inputs behind them.
ENDS_NS = NS_PER_S // 50
# Order of the messages of one time: that of the signal path, from the robot to the arbiter.
PLACES = {topic.key: 2 * [*ROLES, *HELPERS].index(topic.writer) for topic in TOPICS}
MOST_DELAYED = 100  # messages between reading and publishing of one step


class ReplayedRole(NamedTuple):
    """Role that can be replayed."""

    make: Callable[[Bus, CellConfig, "RecordedPart"], Service]
    output: Topic[Any]  # published in every step; of the wrench service only in some of them
    trigger: Topic[Any]  # the output names the sensor sample of the newest message of this topic
    has_silent_steps: bool  # at each of these messages, without an output
    state: Topic[Any]  # by which a known state is recognised
    is_known: Callable[[Any], bool]
    known_text: str


def _arbiter(bus: Bus, cell: CellConfig, part: "RecordedPart") -> ArbiterService:
    """Return an arbiter that has opened as many leases as the recorded one."""
    status = part.state
    numbers = (status.lease, status.ownership) if isinstance(status, ArbiterStatus) else (0, 0)
    return ArbiterService(bus, cell, numbers=numbers)


def _regulator(bus: Bus, cell: CellConfig, part: "RecordedPart") -> Regulator:
    """Return a regulator that reports the end of the last session and contact, as the recorded."""
    reason = STOPPED if part.state is None else part.state.reason
    return Regulator(bus, cell, stop_reason=reason, contact=part.contact)


REPLAYED_ROLES = {
    "wrench": ReplayedRole(
        lambda bus, cell, _: WrenchService(bus, cell), topics.WRENCH, topics.SENSOR_WRENCH,
        True, topics.WRENCH, lambda _: True, "its inputs are received",
    ),
    "regulator": ReplayedRole(
        _regulator, topics.REGULATOR_TARGET, topics.WRENCH, False,
        topics.REGULATOR_TARGET, lambda target: not target.valid and target.mode is None,
        "no force feedback runs",
    ),
    "arbiter": ReplayedRole(
        _arbiter, topics.ROBOT_COMMAND, topics.REGULATOR_TARGET, False,
        topics.ARBITER_STATUS, lambda status: status.state == "IDLE",
        f"the arbiter is IDLE, {SETTLES_NS / NS_PER_S:g} s before the arm is armed",
    ),
}  # fmt: skip


class Recorded(NamedTuple):
    """One decoded message of a recording."""

    topic: str
    at_ns: int  # wall clock time
    data: bytes
    header: Header
    message: Message


@dataclass(slots=True)
class Step:
    """One step of a service."""

    at_ns: int  # time of its clock: that of the publication
    read_ns: int  # it receives what was published before
    place: int  # order of reading among the messages of that time
    until_ns: int  # requests taken until then were served in this step
    requests: list[ServedRequest] = field(default_factory=list)


@dataclass(slots=True)
class SeededBus(Bus):
    """Bus whose publishers continue the sequence numbers of a recording."""

    first_seq: dict[str, int] = field(default_factory=dict)

    def publisher(self, topic: Topic[Any]) -> Publisher[Any]:
        """Return the publisher of a topic, with the recorded numbers."""
        made = Bus.publisher(self, topic)
        made.seq = self.first_seq.get(topic.key, 1) - 1
        return made


@dataclass(slots=True)
class RecordedPart:
    """What a recording has of one role, from a moment at which its state is known."""

    role: str
    state: Message | None  # at its beginning, None at the start of its process
    own: list[Recorded]  # its messages, without its health
    steps: list[Step]
    offset_ns: int  # wall clock less the clock of its process
    compared_ns: int  # wall clock time from which its messages are compared
    until_ns: int
    notes: list[str]
    contact: ContactEvent | None = None  # of the regulator, before its beginning

    @property
    def begin_ns(self) -> int:
        """Wall clock time of its first step."""
        return self.steps[0].at_ns

    def compared_topics(self) -> list[str]:
        """Return its topics, without those that did not exist when it was recorded."""
        recorded = {each.topic for each in self.own}
        written = topics_written_by(self.role)
        return [row.key for row in written if row.occasional or row.key in recorded]

    def first_seq(self) -> dict[str, int]:
        """Return the first sequence number of each of its topics."""
        return {each.topic: each.header.seq for each in reversed(self.own)}

    def step_of(self, each: Recorded) -> int:
        """Return the number of the step in which a message was published."""
        if isinstance(each.message, ServedRequest):
            taken_ns = each.message.received_ns + self.offset_ns
            return bisect_left(self.steps, taken_ns, key=lambda step: step.until_ns)
        return bisect_right(self.steps, each.at_ns, key=lambda step: step.at_ns) - 1


def topics_written_by(role: str) -> list[Topic[Any]]:
    """Return the topics of a role, without its health, which describes the process."""
    return [topic for topic in TOPICS if topic.writer == role and topic != HEALTH[role]]


def recorded_part(messages: list[RecordedBytes], role: str) -> RecordedPart:
    """Return what a recording has of a role.

    Raises:
        DataError: It has nothing of it, or no moment at which its state is known.
    """
    row = REPLAYED_ROLES[role]
    everything = list(_decoded(messages, topics_written_by(role)))
    if not any(each.topic == row.output.key for each in everything):
        raise DataError(f"the recording has no {row.output.key}: {role} has nothing to compare")
    start = _start(messages, everything, role)
    own, end_ns = _of_one_process(everything, start.at_ns)
    notes = _notes(messages, own, role)
    if end_ns != NEVER_NS:
        after_s = (end_ns - own[0].at_ns) / NS_PER_S
        notes.append(f"only until its process was restarted {after_s:.3f} s later")
    part = RecordedPart(
        role,
        start.state,
        own,
        _steps(messages, own, row, end_ns),
        offset_ns=own[0].at_ns - own[0].header.stamp_ns,
        compared_ns=start.compared_ns,
        until_ns=messages[-1].at_ns - ENDS_NS,
        notes=notes,
        contact=_contact_before(everything, start),
    )
    # The recording may end within a step.
    part.own = [each for each in part.own if part.step_of(each) < len(part.steps)]
    _add_requests(part)
    return part


def _contact_before(everything: list[Recorded], start: "Start") -> ContactEvent | None:
    """Return the last contact that a process published before a start within its life."""
    if start.state is None:
        return None
    before = [each.message for each in everything if each.at_ns < start.at_ns]
    return next((each for each in reversed(before) if isinstance(each, ContactEvent)), None)


def _of_one_process(everything: list[Recorded], begin_ns: int) -> tuple[list[Recorded], int]:
    """Return the messages of a process from a time on, and when another one has replaced it."""
    own = [each for each in everything if each.at_ns >= begin_ns]
    epoch = own[0].header.epoch
    end_ns = next((each.at_ns for each in own if each.header.epoch != epoch), NEVER_NS)
    return [each for each in own if each.at_ns < end_ns], end_ns


def _decoded(messages: list[RecordedBytes], chosen: list[Topic[Any]]) -> Iterator[Recorded]:
    """Yield the messages of some topics that can be decoded, in the order of time."""
    rows = {topic.key: topic for topic in chosen}
    for each in messages:
        if each.topic in rows:
            try:
                header, message = decode_recorded(each.data, rows[each.topic].message, each.topic)
            except MessageError:
                continue
            yield Recorded(*each, header, message)


def _sample(each: Recorded) -> int | None:
    """Return the number of the sensor sample that a message is based on."""
    return each.header.seq if each.topic == topics.SENSOR_WRENCH.key else each.header.sensor_seq


def _steps(
    messages: list[RecordedBytes], own: list[Recorded], row: ReplayedRole, end_ns: int
) -> list[Step]:
    """Return the steps of a process until it was replaced."""
    outputs = [each for each in own if each.topic == row.output.key]
    triggers = list(_decoded(messages, [row.trigger]))
    steps = [_step(each, triggers) for each in outputs]
    if row.has_silent_steps:
        within = [each for each in triggers if own[0].at_ns <= each.at_ns < end_ns]
        steps += _silent_steps(steps, outputs, within)
    return sorted(steps, key=lambda step: step.at_ns)


def _step(output: Recorded, triggers: list[Recorded]) -> Step:
    """Return the step of an output: it read its inputs before a newer sample was published.

    The output names the sample of the newest trigger that it had received. So a process that was
    interrupted between reading and publishing is replayed with the inputs that it had.
    """
    at_ns, place = output.at_ns, PLACES[output.topic]
    end = bisect_right(triggers, (at_ns, place), key=lambda each: (each.at_ns, PLACES[each.topic]))
    for number in range(end - 1, max(end - MOST_DELAYED, 0) - 1, -1):
        if _sample(triggers[number]) == output.header.sensor_seq:
            if number + 1 < end:
                newer = triggers[number + 1]
                return Step(at_ns, newer.at_ns, PLACES[newer.topic] - 1, at_ns)
            break
    return Step(at_ns, at_ns, place, at_ns)


def _silent_steps(
    steps: list[Step], outputs: list[Recorded], triggers: list[Recorded]
) -> Iterator[Step]:
    """Yield the steps without an output: at each trigger that no output names.

    A trigger during another step waits for its end, unless a newer one replaces it before.
    """
    named = {each.header.sensor_seq for each in outputs}
    place = PLACES[outputs[0].topic]
    for each, newer in pairwise([*triggers, None]):
        if each is None or each.header.seq in named:
            continue
        following = bisect_left(steps, each.at_ns, key=lambda step: step.at_ns)
        at_ns = each.at_ns
        if following < len(steps) and steps[following].read_ns <= at_ns < steps[following].at_ns:
            at_ns = steps[following].at_ns
        newer_ns = NEVER_NS if newer is None else newer.at_ns
        if newer_ns > at_ns:
            yield Step(at_ns, at_ns, place, newer_ns - 1)


def _add_requests(part: RecordedPart) -> None:
    """Give each request to the step that served it."""
    for each in part.own:
        if isinstance(each.message, ServedRequest):
            part.steps[part.step_of(each)].requests.append(each.message)


# --- start within a recording ---------------------------------------------------------------------


class Start(NamedTuple):
    """Moment at which the state of a service is known."""

    state: Message | None  # None: its process starts
    at_ns: int
    compared_ns: int


def _start(messages: list[RecordedBytes], own: list[Recorded], role: str) -> Start:
    """Return the start of the process, or the first moment at which its state is known.

    That is when it has received all inputs, and publishes what a new process publishes.

    Raises:
        DataError: There is none.
    """
    row = REPLAYED_ROLES[role]
    outputs = [each for each in own if each.topic == row.output.key]
    for each in outputs:
        if each.header.seq == 1:
            return Start(None, each.at_ns, each.at_ns)
    keys = {topic.key for topic in TOPICS if role in topic.readers and not topic.occasional}
    first_ns = {each.topic: each.at_ns for each in reversed(messages) if each.topic in keys}
    for each in reversed(own):
        if each.topic == topics.CONTACT.key:
            first_ns[each.topic] = each.at_ns + 1  # its start continues from this
    first_ns["own"] = outputs[0].at_ns
    states = [each for each in own if each.topic == row.state.key]
    for number, each in enumerate(states):
        if each.at_ns >= max(first_ns.values()) and row.is_known(each.message):
            settled_ns = each.at_ns + SETTLES_NS
            soon = (later.message for later in states[number:] if later.at_ns <= settled_ns)
            if all(_lease(later) == _lease(each.message) for later in soon):
                step_ns = max(out.at_ns for out in outputs if out.at_ns <= each.at_ns)
                return Start(each.message, step_ns, settled_ns)
    raise DataError(
        f"the recording does not reach back far enough for {role}: it must contain the start of "
        f"its process, or a moment at which {row.known_text}. Start the recording earlier: "
        f"`forcemesh record start --past` includes the minutes in memory"
    )


def _lease(state: Message) -> int:
    """Return the lease of an arbiter's status, 0 of any other message."""
    return state.lease if isinstance(state, ArbiterStatus) else 0


def _notes(messages: list[RecordedBytes], own: list[Recorded], role: str) -> list[str]:
    """Return what a replay lacks of the requests that the process has served."""
    epoch, begin_ns, end_ns = own[0].header.epoch, own[0].at_ns, own[-1].at_ns
    healths = [
        health
        for health in _decoded(messages, [HEALTH[role]])
        if health.header.epoch == epoch and begin_ns <= health.at_ns <= end_ns
    ]
    if not healths:
        return ["its health is not in the recording: requests served before are unknown"]
    last = healths[-1]
    total = last.message.counters.get("requests") if isinstance(last.message, Health) else None
    if total is None:
        return ["recorded without requests: what they changed appears as a difference"]
    counted = [each for each in own if isinstance(each.message, ServedRequest)]
    missing = total - sum(each.at_ns <= last.at_ns for each in counted)
    if missing <= 0:
        return []
    text = "what they changed (gains, calibration, speeds, an arm in contact)"
    served = f"{missing} requests were served before this, or are not in the recording"
    return [f"{served}: {text} appears as a difference"]

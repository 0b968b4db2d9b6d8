"""The arbiter's process on a virtual clock, among roles that the test plays."""

from typing import Any

from common.bus.memory_bus import MemoryCall
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus, Origin, Publisher
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import encode_record
from forcemesh.messages import ArbiterStatus, RobotCommand
from forcemesh.records import Record
from forcemesh.requests import ArmRequest
from forcemesh.topics import HEALTH
from services.arbiter.service import ArbiterService
from tests.fakes.arbiter_world import good_messages
from tests.fakes.bench import CELL, Bench

TOPIC_OF: dict[str, topics.Topic[Any]] = {
    "robot": topics.ROBOT_STATE,
    "sensor": topics.SENSOR_WRENCH,
    "wrench": topics.WRENCH,
    "target": topics.REGULATOR_TARGET,
}


def topic_of(name: str) -> topics.Topic[Any]:
    """Return the topic of a name in the list of good messages."""
    return TOPIC_OF[name] if name in TOPIC_OF else HEALTH[name.removesuffix("/health")]


class Cellmates(Bench):
    """The arbiter among roles that publish every period until they are stopped."""

    def __init__(self, cell: CellConfig = CELL) -> None:
        """Start with every role running and without faults."""
        super().__init__("arbiter", ArbiterService, cell)
        self.messages = good_messages(cell)
        self.dead: set[str] = set()
        self.rivals: dict[str, Publisher[Any]] = {}  # second publishers, read last
        self.sample_age_s = 0.002  # of the sensor's sample behind a wrench
        self.before_step = self._publish_all
        self.command = self.watch(topics.ROBOT_COMMAND)
        self.status = self.watch(topics.ARBITER_STATUS)

    def _publish_all(self) -> None:
        sample_ns = self.clock.now_ns() - round(self.sample_age_s * NS_PER_S)
        origins = {"target": Origin(1234, 5), "wrench": Origin(sample_ns, 5)}
        for name, message in self.messages.items():
            if name not in self.dead:
                self.put(topic_of(name), message, origins.get(name))
        for name, rival in self.rivals.items():
            rival.put(self.messages[name])

    def change(self, name: str, **changes: Any) -> None:
        """Change fields of the message of one role."""
        self.messages[name] = self.messages[name].replaced(**changes)

    def add_rival(self, name: str) -> None:
        """Start a second process that publishes the topic of one role."""
        topic = topic_of(name)
        bus = Bus(topic.writer, self.cell.cell, self.transport, self.cell, self.clock)
        self.rivals[name] = bus.publisher(topic)

    def move_away(self, name: str) -> None:
        """Publish one role's messages from another host from now on."""
        topic = topic_of(name)
        clock = ManualClock(10**14, boot="elsewhere")  # a day ahead
        bus = Bus(topic.writer, self.cell.cell, self.transport, self.cell, clock)
        self._publishers[topic.key] = bus.publisher(topic)

    def last_status(self) -> ArbiterStatus:
        """Return the arbiter's last status."""
        status: ArbiterStatus = self.newest(topics.ARBITER_STATUS)
        return status

    def codes(self) -> list[str]:
        """Return the codes of the trips."""
        return [trip.code for trip in self.last_status().trips]

    def published(self) -> RobotCommand:
        """Return the arbiter's last command."""
        command: RobotCommand = self.newest(topics.ROBOT_COMMAND)
        return command

    def arm(self) -> "Cellmates":
        """Advance past the preflight and arm."""
        self.pass_s(1.1)
        assert self.ask(topics.ARM, ArmRequest()).accepted
        self.pass_s(0.4)
        assert self.last_status().state == "ARMED"
        return self

    def ask_at_once(self, *requests: tuple[topics.Request[Any], Record]) -> None:
        """Send several requests within one period."""
        for request, message in requests:
            waiting = self.transport.serve(f"{self.cell.cell}/{request.key}").waiting
            waiting.append(MemoryCall(encode_record(message)))
        self.step()

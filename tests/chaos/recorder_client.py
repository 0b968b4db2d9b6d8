"""Recorder client: messages of the cell during a fault, in order of arrival."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.messages import ArbiterStatus, RobotCommand, RobotState

POLL_S = 0.001
MOVING = ("goal", "setpoint", "feedback")

Key = tuple[int, int]  # epoch of the publisher, number of the message


@dataclass(slots=True)
class RecordedMessages:
    """Records since `RecorderClient.begin`."""

    # Commands accepted for motion by the robot: time [ns], and their age [s]; 0: unknown.
    accepted: dict[Key, tuple[int, float]] = field(default_factory=dict)
    codes: list[str] = field(default_factory=list)  # of the arbiter's trips, in order


class RecorderClient:
    """Subscriber of commands, robot state and arbiter status."""

    def __init__(self, bus: Bus) -> None:
        """Subscribe."""
        self.bus, self._clock = bus, bus.clock
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._command = bus.reader(topics.ROBOT_COMMAND)
        self._arbiter = bus.reader(topics.ARBITER_STATUS)
        self._wrench = bus.reader(topics.WRENCH)
        self._written: dict[Key, tuple[int, str]] = {}  # time [ns] and kind
        self.notes = RecordedMessages()

    def begin(self) -> None:
        """Discard all records."""
        self.notes = RecordedMessages()
        self._written.clear()

    def until(self, what: Callable[[], bool], timeout_s: float) -> bool:
        """Receive until a condition holds; return False after the time-out."""
        give_up_s = time.monotonic() + timeout_s
        while True:
            self._listen()
            if what():
                return True
            if time.monotonic() >= give_up_s:
                return False
            time.sleep(POLL_S)

    def during(self, duration_s: float) -> None:
        """Receive for a duration."""
        self.until(lambda: False, duration_s)

    def robot(self) -> RobotState | None:
        """Return the latest robot state if it is fresh."""
        return self._robot.read(self._clock.now_ns()).fresh

    def arbiter(self) -> ArbiterStatus | None:
        """Return the latest arbiter status if it is fresh."""
        return self._arbiter.read(self._clock.now_ns()).fresh

    def force_N(self) -> float | None:
        """Return the latest force along base z [N] if it is fresh."""
        wrench = self._wrench.read(self._clock.now_ns()).fresh
        return None if wrench is None else wrench.force_N[2]

    def _listen(self) -> None:
        now_ns = self._clock.now_ns()
        command = self._command.read(now_ns)
        if command.header is not None and command.message is not None:
            key = (command.header.epoch, command.header.seq)
            self._written[key] = (command.header.stamp_ns, kind_of(command.message))
        robot, arbiter = self._robot.read(now_ns).message, self.arbiter()
        if robot is not None:
            self._note_robot(robot)
        if arbiter is not None:
            collected = self.notes.codes
            collected.extend(trip.code for trip in arbiter.trips if trip.code not in collected)

    def _note_robot(self, robot: RobotState) -> None:
        notes, accepted = self.notes, robot.accepted
        if accepted is None:
            return
        # A command that was not received here counts as motion, to be conservative.
        key = (accepted.epoch, accepted.seq)
        written_ns, kind = self._written.get(key, (accepted.at_ns, "goal"))
        if kind in MOVING:
            age_s = (accepted.at_ns - written_ns) / NS_PER_S
            notes.accepted[key] = (accepted.at_ns, age_s)


def kind_of(command: RobotCommand) -> str:
    """Return the kind of a command; without permission it is a hold."""
    return "hold" if command.permission is None else command.kind

"""Bus checks of a running cell: health, robot state and topic rates."""

import time
from dataclasses import dataclass, field
from typing import Any

from cli.doctor.checks import ObservedRole
from cli.status import helpers_of
from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import cell_hash
from forcemesh import topics
from forcemesh.bus import Bus, Reader
from forcemesh.errors import BusError
from forcemesh.messages import Health, RobotState
from launch.cell_view import CellView
from launch.run_file import read_run

CONNECT_WITHIN_S = 0.5
OBSERVED_S = 3.0
RATE_POLL_S = 0.002
STREAMS = (
    topics.ROBOT_STATE,
    topics.SENSOR_WRENCH,
    topics.WRENCH,
    topics.REGULATOR_TARGET,
    topics.ROBOT_COMMAND,
)


@dataclass(slots=True)
class ObservedCell:
    """State of a cell as received from its bus."""

    roles: list[ObservedRole]
    robot: Health | None  # the robot's process, while its health is fresh
    state: RobotState | None  # the newest, valid or not
    stream_hz: dict[str, float | None] = field(default_factory=dict)


def observe_cell(cell: CellConfig, watch_s: float = OBSERVED_S) -> ObservedCell | None:
    """Receive from a cell for some seconds; return None when no hub responds."""
    try:
        with open_bus(cell, topics.CLIENT, patience_s=CONNECT_WITHIN_S) as bus:
            view, counts = CellView(bus, cell), [_Count(bus.reader(row)) for row in STREAMS]
            end_s = time.monotonic() + max(watch_s, view.longest_wait_s)
            while time.monotonic() < end_s:
                for count in counts:
                    count.poll()
                time.sleep(RATE_POLL_S)
            return _observed_cell(cell, bus, view, counts)
    except BusError:
        return None


class _Count:
    """Rate of a topic, from the sequence numbers of its messages: none is missed."""

    def __init__(self, reader: Reader[Any]) -> None:
        """Begin with the next message."""
        self.reader = reader
        self._first: tuple[int, int, int] | None = None  # epoch, seq, at
        self._last = (0, 0, 0)

    def poll(self) -> None:
        """Receive a newer message, if any."""
        if not self.reader.poll():
            return
        now_ns = time.monotonic_ns()
        header = self.reader.read(now_ns).header
        if header is not None:
            self._last = (header.epoch, header.seq, now_ns)
            if self._first is None or self._first[0] != header.epoch:
                self._first = self._last

    @property
    def hz(self) -> float | None:
        """Messages per second, None with fewer than two messages."""
        if self._first is None or self._first == self._last:
            return None
        return (self._last[1] - self._first[1]) * 1e9 / (self._last[2] - self._first[2])


def _observed_cell(
    cell: CellConfig, bus: Bus, view: CellView, counts: list[_Count]
) -> ObservedCell:
    state = counts[0].reader.read(bus.clock.now_ns()).message
    return ObservedCell(
        roles=[
            _role(cell, view, role)
            for role in (*topics.ROLES, *helpers_of(view, read_run(cell.cell)))
        ],
        robot=_current_health(view, "robot"),
        state=state if isinstance(state, RobotState) else None,
        stream_hz={count.reader.topic.key: count.hz for count in counts},
    )


def _current_health(view: CellView, role: str) -> Health | None:
    message = view.health(role).fresh
    return message if isinstance(message, Health) else None


def _role(cell: CellConfig, view: CellView, role: str) -> ObservedRole:
    reading = view.health(role)
    message = reading.message
    if message is None:
        return ObservedRole(role, None, is_fresh=False)
    observed = ObservedRole(role, reading.age_s, is_fresh=not reading.silent)
    if not isinstance(message, Health):
        return observed
    return ObservedRole(
        role,
        reading.age_s,
        is_fresh=not reading.silent,
        rate_hz=message.rate_hz,
        fault=message.fault,
        same_config=message.config_hash == cell_hash(cell),
        version=message.version,
    )

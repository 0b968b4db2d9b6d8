"""Bus checks of a running cell: health, robot state and topic rates."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cli.status import helpers_of
from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.client.feed import Feed
from forcemesh.errors import BusError, LostError
from forcemesh.messages import Health, RobotState, SensorWrench
from launch.cell_view import CellView
from launch.run_file import read_run

CONNECT_WITHIN_S = 0.5
OBSERVED_S = 3.0
RATE_POLL_S = 0.002
STREAMS: tuple[topics.Topic[Any], ...] = (  # besides robot/state
    topics.SENSOR_WRENCH,
    topics.WRENCH,
    topics.REGULATOR_TARGET,
    topics.ROBOT_COMMAND,
)


@dataclass(slots=True)
class ObservedCell:
    """State of a cell as received from its bus."""

    roles: Mapping[str, Reading[Health] | Reading[SensorWrench]]  # health, or an external sensor
    robot: Health | None  # the robot's process, while its health is fresh
    state: RobotState | None  # the newest, valid or not
    stream_hz: dict[str, float | None] = field(default_factory=dict)


def observe_cell(cell: CellConfig, watch_s: float = OBSERVED_S) -> ObservedCell | None:
    """Receive from a cell for some seconds; return None when no hub responds."""
    try:
        with open_bus(cell, topics.CLIENT, patience_s=CONNECT_WITHIN_S) as bus:
            view, robot = CellView(bus, cell), Feed(bus, topics.ROBOT_STATE, LostError)
            feeds = [robot, *(Feed(bus, row, LostError) for row in STREAMS)]
            end_s = time.monotonic() + max(watch_s, view.longest_wait_s)
            while time.monotonic() < end_s:
                for feed in feeds:
                    feed.reading()
                time.sleep(RATE_POLL_S)
            return _observed_cell(cell, view, robot, feeds)
    except BusError:
        return None


def _observed_cell(
    cell: CellConfig, view: CellView, robot: Feed[RobotState], feeds: list[Feed[Any]]
) -> ObservedCell:
    roles = (*topics.ROLES, *helpers_of(view, read_run(cell.cell)))
    return ObservedCell(
        roles={role: view.health(role) for role in roles},
        robot=view.fresh_health("robot"),
        state=robot.reading().message,
        stream_hz={feed.topic.key: feed.rate_hz for feed in feeds},
    )

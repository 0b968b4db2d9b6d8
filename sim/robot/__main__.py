"""Simulated robot: plays the roles robot and sensor of a cell."""

from common.bus import open_bus
from common.priority import take_realtime_priority
from common.service import (
    Runner,
    cell_from_arguments,
    exit_on_error,
    refuse_unless_played_by,
    reporter_of,
    stop_on_signals,
)
from sim.robot.service import SimRobot


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    cell = cell_from_arguments("robot")
    stop = stop_on_signals()
    take_realtime_priority()
    with exit_on_error("robot"):
        for role in ("robot", "sensor"):
            refuse_unless_played_by(cell, role, "sim")
        with open_bus(cell, "robot") as bus:
            robot = SimRobot(bus, cell)
            reporters = [reporter_of(bus, cell), reporter_of(bus.playing("sensor"), cell)]
            Runner(robot, reporters, bus.clock).run(stop)


if __name__ == "__main__":
    main()

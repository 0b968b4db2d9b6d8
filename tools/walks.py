"""Traces walks through the code in a virtual cell: a wrench sample to the arm, and a `move`.

    python -m tools.walks            the table
    python -m tools.walks --list     every file and function as well, in the order of the walk

Counted is every function of ours that runs meanwhile, once, and every file that holds one:

- sample: one control period of force feedback with the adaptive law in mode both, from the sensor's
  reading to the joints that the simulated arm is given;
- sample over TCP: the same with the gateway, as far as the wire; what emulates the controller, and
  the arm behind it, is not counted;
- move: from a client's request to the robot's report that the goal runs; the other services have
  their say meanwhile, and are counted.

Not counted: hub, bus in memory, virtual clock, and what Python makes by itself: generated
`__init__`, comprehensions, lambdas.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import RobotState
from forcemesh.requests import MoveRequest
from launch.virtual_cell import VirtualCell
from tools.tree import PRODUCTION, ROOT

CELLS = ROOT / "cells"
READY_S = 1.8  # until a cell may be armed
OURS = tuple(room for room in PRODUCTION if room not in ("launch", "cli"))
LEFT_OUT = ("services/hub/", "common/bus/memory_bus.py", "common/runtime/overruns.py")
MOVE_M = 0.01


class Trace:
    """Which functions of ours have run, in order."""

    def __init__(self, left_out: tuple[str, ...] = LEFT_OUT) -> None:
        """Nothing yet; how the paths begin that are not counted."""
        self.functions: dict[tuple[str, str], None] = {}
        self._left_out = left_out

    @contextmanager
    def on(self) -> Iterator[None]:
        """Note every call meanwhile."""
        sys.setprofile(self._called)
        try:
            yield
        finally:
            sys.setprofile(None)

    def _called(self, frame: FrameType, event: str, _: Any) -> None:
        place = place_of(frame.f_code) if event == "call" else None
        if place is not None and not place[0].startswith(self._left_out):
            self.functions.setdefault(place)

    @property
    def files(self) -> list[str]:
        """The files, in the order in which the walk enters them."""
        return list(dict.fromkeys(file for file, _ in self.functions))


def place_of(code: CodeType) -> tuple[str, str] | None:
    """Return file and name of a function of ours; None for what is not counted."""
    path = Path(code.co_filename)
    if not path.is_relative_to(ROOT) or code.co_name.startswith("<"):
        return None
    file = path.relative_to(ROOT).as_posix()
    if file.partition("/")[0] not in OURS:
        return None
    return file, code.co_qualname


def client_of(cell: VirtualCell) -> ConfiguredCell:
    """Return a client of a cell that may be armed."""
    cell.advance(READY_S)
    return ConfiguredCell(cell.cell, commander="operator", bus=cell.client)


def pressing(file: str) -> VirtualCell:
    """Return a cell that presses on its plate."""
    cell = VirtualCell(load_cell(CELLS / file, {"sim.gap_m": 0.001}))
    client = client_of(cell)
    client.tare()
    client.arm()
    client.force.start(20.0, mode="both", law="adaptive")
    cell.advance(2.0)
    return cell


def sample_walk() -> Trace:
    """Trace one control period: a sample is taken, and its set point reaches the arm."""
    return period_of(pressing("demo.yaml"), Trace())


def sample_over_tcp_walk() -> Trace:
    """Trace one control period as far as the bytes for the controller."""
    return period_of(pressing("demo-tcp.yaml"), Trace(left_out=(*LEFT_OUT, "sim/")))


def period_of(cell: VirtualCell, trace: Trace) -> Trace:
    """Trace one control period."""
    with trace.on():
        cell.advance(1.0 / cell.cell.rates.control_hz)
    return trace


def move_walk() -> Trace:
    """Trace a move from the client's call until the robot says that it runs."""
    cell, trace = VirtualCell(load_cell(CELLS / "demo.yaml", {"sim.gap_m": 0.05})), Trace()
    client = client_of(cell)
    client.arm("jog")
    robot = cell.client.reader(topics.ROBOT_STATE)

    def runs() -> bool:
        state = robot.read(cell.clock.now_ns()).message
        return isinstance(state, RobotState) and state.goal.state == "running"

    wish = MoveRequest(kind="pose", pose=client.move.jogged((0.0, 0.0, MOVE_M), axes="base"))
    with trace.on():
        client.move.begin(wish)
        cell.advance(1.0, runs)
    return trace


WALKS: dict[str, Callable[[], Trace]] = {
    "sample": sample_walk,
    "sample over TCP": sample_over_tcp_walk,
    "move": move_walk,
}


def main(words: list[str]) -> None:
    """Print the table, and the walks themselves if asked for."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m tools.walks")
    parser.add_argument("--list", action="store_true", help="every file and function as well")
    asked = parser.parse_args(words)
    for name, walk in WALKS.items():
        trace = walk()
        print(f"{name}: {len(trace.files)} files, {len(trace.functions)} functions")
        if asked.list:
            for file in trace.files:
                names = ", ".join(function for where, function in trace.functions if where == file)
                print(f"  {file}: {names}")


if __name__ == "__main__":
    main(sys.argv[1:])

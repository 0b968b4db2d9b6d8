"""Test cell in real processes with a client; shared by network, flood and soak.

The cell has its own name, ports and run folder, so it does not interfere with other cells.
"""

import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import dump_cell, load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import Array
from common.runtime.realtime import take_realtime_priority
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.errors import ForcemeshError
from forcemesh.messages import ArbiterStatus, RobotState
from forcemesh.requests import Empty, ForceStartRequest, HoldRequest, MoveRequest, Reply
from forcemesh.topics import Q, Request
from launch.processes import Supervisor
from launch.started_process import LAUNCHER, ProcessSpec

ROOT = Path(__file__).resolve().parents[2]
RUN_FOLDER = "FORCEMESH_RUN_FOLDER"
OURS = range(20_000, 32_000)  # below the ephemeral ports, which start at 32768
POLL_S = 0.002
PATIENCE_S = 30.0  # time-out of the harness on a loaded machine


class HarnessError(ForcemeshError):
    """Error of the test harness: the trial could not be carried out, there is no verdict."""


def free_port() -> int:
    """Return a TCP port of loopback that is currently free.

    Not an ephemeral port: an outgoing connection, even of a client that waits for this port, could
    occupy it before the intended listener.
    """
    while True:
        port = random.SystemRandom().choice(OURS)
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def make_cell(
    template: str, folder: Path, overrides: Mapping[str, object]
) -> tuple[CellConfig, Path]:
    """Write a cell file with overrides, its hub on a free port; return the cell and its file."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    cell = load_cell(ROOT / "cells" / f"{template}.yaml", {"bus.endpoint": endpoint, **overrides})
    path = folder / "cell.yaml"
    path.write_text(dump_cell(cell), encoding="utf-8")
    return cell, path


class CellUnderTest:
    """Client of a running cell. Waits poll the bus; all times are CLOCK_MONOTONIC."""

    poll_s = POLL_S

    def __init__(self, cell: CellConfig, client: Bus) -> None:
        """Subscribe as a client."""
        self.cell, self.client, self.clock = cell, client, client.clock
        self._arbiter = client.reader(topics.ARBITER_STATUS)
        self._robot = client.reader(topics.ROBOT_STATE)
        self._wrench = client.reader(topics.WRENCH)
        self._health = {role: client.reader(topics.HEALTH[role]) for role in topics.ROLES}

    # --- observation ------------------------------------------------------------------------------

    @property
    def status(self) -> ArbiterStatus | None:
        """Latest arbiter status, if fresh."""
        return self._arbiter.read(self.clock.now_ns()).fresh

    @property
    def state(self) -> str:
        """State of the arbiter, empty without a fresh status."""
        status = self.status
        return "" if status is None else status.state

    @property
    def robot(self) -> RobotState | None:
        """Latest robot state, if fresh and valid."""
        return self._robot.read(self.clock.now_ns()).fresh

    @property
    def held(self) -> bool:
        """Whether a fresh robot state reports a hold."""
        robot = self.robot
        return robot is not None and bool(robot.hold_reason)

    @property
    def last_robot(self) -> RobotState:
        """Last robot state, however old. Raises HarnessError if none was received."""
        robot = self._robot.read(self.clock.now_ns()).message
        if robot is None:
            raise HarnessError("no robot state received")
        return robot

    def joints(self) -> Array:
        """Return the last measured joint angles [rad]."""
        return np.array(self.last_robot.joint_rad)

    @property
    def force_N(self) -> float:
        """Magnitude of the force [N], NaN if unknown."""
        wrench = self._wrench.read(self.clock.now_ns()).fresh
        return float("nan") if wrench is None else float(np.linalg.norm(wrench.force_N))

    def pids(self) -> dict[str, int]:
        """Return process IDs by role, for the roles with fresh health."""
        now_ns = self.clock.now_ns()
        health_of = {role: reader.read(now_ns).fresh for role, reader in self._health.items()}
        return {role: health.pid for role, health in health_of.items() if health is not None}

    def causes(self) -> str:
        """Return the hold codes of the arbiter and the robot."""
        status, robot = self.status, self.robot
        codes = {trip.code for trip in status.trips} if status is not None else set()
        if robot is not None and robot.hold_code:
            codes.add(robot.hold_code)
        return " ".join(sorted(codes))

    def until(self, what: Callable[[], object], name: str, within_s: float = PATIENCE_S) -> float:
        """Wait for a condition; return the time [s]. Raise HarnessError after the time-out."""
        began_s = time.monotonic()
        while not what():
            if time.monotonic() >= began_s + within_s:
                raise HarnessError(f"not within {within_s:g} s: {name}; the arbiter: {self.status}")
            time.sleep(self.poll_s)
        return time.monotonic() - began_s

    # --- commands ---------------------------------------------------------------------------------

    def ask(self, request: Request[Q], message: Q) -> Reply:
        """Send a request; raise HarnessError if it is rejected."""
        reply = self.client.ask(request, message)
        if not reply.accepted:
            raise HarnessError(f"{request.key} was refused ({reply.code}): {reply.text}")
        return reply

    def insist(self, request: Request[Q], message: Q, within_s: float = PATIENCE_S) -> None:
        """Repeat a request until it is accepted: arming requires inputs valid for some time."""
        give_up_s = time.monotonic() + within_s
        while True:
            try:
                self.ask(request, message)
            except ForcemeshError:
                if time.monotonic() >= give_up_s:
                    raise
                time.sleep(0.05)
            else:
                return

    def make_ready(self) -> None:
        """Hold, clear and arm from any state."""
        self.insist(topics.HOLD, HoldRequest(reason="the next round"))
        self.insist(topics.CLEAR, Empty())
        self.insist(topics.ARM, topics.ARM.message())

    def tare(self) -> None:
        """Tare in free space, as soon as the wrench has enough samples."""
        self.insist(topics.TARE, Empty())

    def press(self, force_N: float) -> None:
        """Start force feedback with a set point, after an active move has ended."""
        start = ForceStartRequest(mode="position", setpoint_N=force_N)
        self.insist(topics.FORCE_START, start, within_s=5.0)

    def move_to(self, z_m: float, speed_m_s: float) -> None:
        """Start a linear move of the flange to a height."""
        self.until(lambda: self.robot is not None, "a robot state")
        T = pose_of(self.last_robot)
        T.translation = np.array([T.translation[0], T.translation[1], z_m])
        move = MoveRequest(kind="pose", pose=record_of(T), speed_m_s=speed_m_s)
        self.insist(topics.MOVE, move, within_s=5.0)

    def height_m(self) -> float:
        """Return the measured height of the flange [m]."""
        self.until(lambda: self.robot is not None, "a robot state")
        return self.last_robot.position_m[2]


@contextmanager
def running_cell(
    cell: CellConfig, path: Path, processes: Sequence[ProcessSpec] | None = None
) -> Iterator[CellUnderTest]:
    """Start all processes of a cell, wait until they are ready, always stop them."""
    with ExitStack() as exits:
        exits.enter_context(environment(**{RUN_FOLDER: str(path.parent)}))
        supervisor = Supervisor(cell, path, processes=processes, write_line=log_to(path.parent))
        exits.enter_context(supervisor)
        supervisor.wait_ready(PATIENCE_S)
        client = exits.enter_context(open_bus(cell, topics.CLIENT))
        yield CellUnderTest(cell, client)


@contextmanager
def environment(**variables: str) -> Iterator[None]:
    """Set environment variables for processes started in the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def log_to(folder: Path) -> Callable[[str, str], None]:
    """Return a log function for processes that writes to a file of the folder."""
    log = folder / "processes.log"

    def log_line(who: str, line: str) -> None:
        with log.open("a", encoding="utf-8") as out:
            out.write(f"{who}: {line}\n")

    return log_line


@contextmanager
def child(*words: object, patience_s: float = 5.0) -> Iterator[subprocess.Popen[str]]:
    """Run a module as a child process; it ends with the block, or with this thread."""
    launcher = (sys.executable, "-I", "-S", str(LAUNCHER), str(os.getpid()))
    process = subprocess.Popen(
        [*launcher, sys.executable, "-m", *(str(word) for word in words)],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


def run_guarded(main: Callable[[], int]) -> int:
    """Run a harness at real-time priority, for accurate times; return its exit code."""
    take_realtime_priority()
    try:
        return main()
    except ForcemeshError as error:
        print(f"the harness failed: {error}", file=sys.stderr)
        return 1


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = [f"### {title}", "", f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    lines += [f"| {' | '.join(str(value) for value in row)} |" for row in rows]
    return "\n".join(lines) + "\n"

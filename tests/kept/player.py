"""A virtual cell that a run of `tests/kept` plays on: a client's hands, and faults on the way."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import patch

import numpy as np

from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import rotation_from_vector
from controller.packet import Packet, PacketReader
from forcemesh import topics
from forcemesh.bus import Source
from forcemesh.clock import NS_PER_S
from forcemesh.messages import PoseRecord, RobotState
from forcemesh.requests import (
    ArmRequest,
    AxesRequest,
    Empty,
    ForceStartRequest,
    HoldRequest,
    MoveRequest,
)
from launch import virtual_cell as virtual
from launch.virtual_cell import VirtualCell
from services.gateway.link import News
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.controller.service import ControllerSensor
from sim.robot.ft_sensor import FtSample
from tests.fakes.stalling_wire import StallingWire

CELLS = Path(__file__).parents[2] / "cells"
ORDER = ("sensor", "robot", "hub", "wrench", "regulator", "arbiter")  # of the roles' start
ROOM = 100_000  # messages of one topic: more than any run has
KEPT_TOPICS = (
    topics.WRENCH,
    topics.REGULATOR_TARGET,
    topics.ROBOT_COMMAND,
    topics.ARBITER_STATUS,
    topics.ROBOT_STATE,
)


class KeptWire(StallingWire):
    """A wire in memory that keeps what went over it, and on which one direction can stall."""

    made: ClassVar[list["KeptWire"]] = []  # by the cell that is being made

    def __init__(self, network: MemoryNetwork, port: int, make_news: type[News]) -> None:
        """Nothing has gone over it yet."""
        super().__init__(network, port, make_news)
        self._readers = {"gateway": PacketReader(), "program": PacketReader()}
        self.packets: list[tuple[int, str, Packet]] = []  # when, whose
        KeptWire.made.append(self)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Keep what the gateway says."""
        self._keep("gateway", data, now_ns)
        return super().send(data, now_ns)

    def _receive(self, now_ns: int) -> bytes:
        data = super()._receive(now_ns)
        self._keep("program", data, now_ns)
        return data

    def _keep(self, who: str, data: bytes, now_ns: int) -> None:
        self.packets += [(now_ns, who, packet) for packet in self._readers[who].feed(data)]


class Player:
    """One cell, from its start to the end of a run."""

    def __init__(self, file: str, **changes: Any) -> None:
        """Start every service of a cell file with some values changed."""
        cell = load_cell(CELLS / file, changes)
        with patch.object(virtual, "LockStepLink", KeptWire):
            self.cell = VirtualCell(cell)
        self.wire = KeptWire.made.pop() if KeptWire.made else None
        self.taps: dict[str, Source] = {
            topic.key: self.cell.client.tap(topic, ROOM) for topic in KEPT_TOPICS
        }
        self.replies: list[tuple[int, str, bool, str]] = []
        self._robot = self.cell.client.reader(topics.ROBOT_STATE)

    @property
    def packets(self) -> list[tuple[int, str, Packet]]:
        """What went over the wire, if there is one: when [ns], whose, what."""
        return [] if self.wire is None else self.wire.packets

    # --- time -------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.cell.advance(seconds)

    def until_force_N(self, least_N: float, seconds: float = 3.0) -> None:
        """Let time pass until the plate pushes so hard."""
        self.cell.advance(seconds, lambda: self.pushed_N() >= least_N)

    def pushed_N(self) -> float:
        """How hard the plate truly pushes."""
        return float(np.linalg.norm(self.cell.arm.true_wrench().force_N))

    # --- a client's hands -------------------------------------------------------------------------

    def ask(self, request: topics.Request[Any], message: Any) -> None:
        """Ask, and keep whether it was granted."""
        reply = self.cell.client.ask(request, message)
        self.replies.append((self.cell.clock.now_ns(), request.key, reply.accepted, reply.code))

    def arm(self, purpose: Any = "all") -> None:
        """Acknowledge whatever was, and arm."""
        self.ask(topics.CLEAR, Empty())
        self.ask(topics.ARM, ArmRequest(purpose=purpose))

    def begin(self) -> None:
        """Wait out the preflight, tare, arm."""
        self.wait(1.3 if self.wire is None else 1.7)
        self.ask(topics.TARE, Empty())
        self.arm()

    def force(self, mode: Any = "position", setpoint_N: float = 20.0, **more: Any) -> None:
        """Start force feedback."""
        wanted = ForceStartRequest(mode=mode, setpoint_N=setpoint_N, **more)
        self.ask(topics.FORCE_START, wanted)

    def prove_axes(self) -> None:
        """Take note that `forcemesh check axes` found axes and signs right."""
        wrench = self.cell.client.reader(topics.WRENCH)
        self.wait(0.05)
        said = wrench.read(self.cell.clock.now_ns()).message
        assert said is not None
        self.ask(topics.AXES, AxesRequest(calibration=said.calibration))

    def hold(self) -> None:
        """Hold, and look at the end for a moment."""
        self.ask(topics.HOLD, HoldRequest())
        self.wait(0.2)

    def move(self, **wish: Any) -> None:
        """Ask for a move."""
        self.ask(topics.MOVE, MoveRequest(**wish))

    def beside(self, *shift_m: float, turn_rad: tuple[float, ...] = (0.0, 0.0, 0.0)) -> PoseRecord:
        """Return a flange pose beside where the arm is, base axes."""
        state = self._robot.read(self.cell.clock.now_ns()).message
        assert isinstance(state, RobotState)
        T = pose_of(state)
        T.translation = T.translation + np.array(shift_m)
        T.rotation = rotation_from_vector(np.array(turn_rad)) @ T.rotation
        return record_of(T)

    # --- faults -----------------------------------------------------------------------------------

    def disturb(self, change: Callable[[FtSample], FtSample | None] | None) -> None:
        """Let the sensor say something else from now on; None: what it feels."""
        self.cell.arm.ft_sensor.disturb = change or (lambda sample: sample)

    def freeze(self, role: str, seconds: float) -> None:
        """Let a process stand still, then go on."""
        runner = self.cell.runners.pop(role)
        self.wait(seconds)
        # Back into its place: roles are stepped in the order of their start.
        runners = self.cell.runners | {role: runner}
        self.cell.runners.clear()
        self.cell.runners.update({name: runners[name] for name in ORDER if name in runners})

    def stall(self, direction: str, seconds: float) -> None:
        """Let one direction of the wire stall from now on."""
        assert self.wire is not None
        until_ns = self.cell.clock.now_ns() + round(seconds * NS_PER_S)
        setattr(self.wire, f"{direction}_until_ns", until_ns)

    @property
    def machine(self) -> Machine:
        """The emulated controller."""
        service = self.cell.runners["sensor"].service
        assert isinstance(service, ControllerSensor)
        return service.machine

    def push(self, *force_N: float) -> None:
        """Let a hand push the tool, base axes."""
        body = self.cell.arm.model.body("tool").id
        self.cell.arm.data.xfrc_applied[body, :3] = force_N


def shifted(*by: float) -> Callable[[FtSample], FtSample]:
    """Return what adds six numbers to each reading."""
    add = np.array(by)

    def change(sample: FtSample) -> FtSample:
        force_N, torque_Nm = sample.force_N + add[:3], sample.torque_Nm + add[3:]
        return replace(sample, force_N=force_N, torque_Nm=torque_Nm)

    return change

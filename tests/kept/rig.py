"""A virtual cell of a kept run, with a client and injected faults."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
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
from services.gateway.link import LinkEvents
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.controller.service import ControllerSensor
from sim.robot.ft_sensor import FtSample
from tests.fakes.stalling_wire import StallingWire

CELLS = Path(__file__).parents[2] / "cells"
# Cell files changed since; these runs are about laws.
STORED_WITH = {"deadlines": {"command_s": 0.1, "sensor_s": 0.1}}
ORDER = ("sensor", "robot", "hub", "wrench", "regulator", "arbiter")  # start order of the roles
ROOM = 100_000  # messages of one topic: more than any run has
KEPT_TOPICS = (
    topics.WRENCH,
    topics.REGULATOR_TARGET,
    topics.ROBOT_COMMAND,
    topics.ARBITER_STATUS,
    topics.ROBOT_STATE,
)


class KeptWire(StallingWire):
    """A wire in memory that records its packets, and on which one direction can stall."""

    instances: ClassVar[list["KeptWire"]] = []  # by the cell that is being made

    def __init__(self, network: MemoryNetwork, port: int, make_events: type[LinkEvents]) -> None:
        """Start without packets."""
        super().__init__(network, port, make_events)
        self._readers = {"gateway": PacketReader(), "program": PacketReader()}
        self.packets: list[tuple[int, str, Packet]] = []  # time, source
        KeptWire.instances.append(self)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Record and send the gateway's data."""
        self._keep("gateway", data, now_ns)
        return super().send(data, now_ns)

    def _receive(self, now_ns: int) -> bytes:
        data = super()._receive(now_ns)
        self._keep("program", data, now_ns)
        return data

    def _keep(self, source: str, data: bytes, now_ns: int) -> None:
        self.packets += [(now_ns, source, packet) for packet in self._readers[source].feed(data)]


class KeptRig:
    """One cell, from its start to the end of a run."""

    def __init__(self, file: str, **changes: Any) -> None:
        """Start every service of a cell file with some values changed."""
        cell = load_cell(CELLS / file, STORED_WITH | changes)
        seeded = patch("forcemesh.bus.secrets.randbits", Random(1).getrandbits)
        with patch.object(virtual, "LockStepLink", KeptWire), seeded:
            self.cell = VirtualCell(cell)
        self.wire = KeptWire.instances.pop() if KeptWire.instances else None
        self.taps: dict[str, Source] = {
            topic.key: self.cell.client.tap(topic, ROOM) for topic in KEPT_TOPICS
        }
        self.replies: list[tuple[int, str, bool, str]] = []
        self._robot = self.cell.client.reader(topics.ROBOT_STATE)

    @property
    def packets(self) -> list[tuple[int, str, Packet]]:
        """Packets on the wire, if there is one: time [ns], source, packet."""
        return [] if self.wire is None else self.wire.packets

    # --- time -------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> None:
        """Advance by a time."""
        self.cell.advance(seconds)

    def until_force_N(self, least_N: float, seconds: float = 3.0) -> None:
        """Advance until the contact force reaches a value."""
        self.cell.advance(seconds, lambda: self.pushed_N() >= least_N)

    def pushed_N(self) -> float:
        """Return the true contact force."""
        return float(np.linalg.norm(self.cell.arm.true_wrench().force_N))

    # --- client -----------------------------------------------------------------------------------

    def send_request(self, request: topics.Request[Any], message: Any) -> None:
        """Send a request, and record the reply."""
        reply = self.cell.client.ask(request, message)
        self.replies.append((self.cell.clock.now_ns(), request.key, reply.accepted, reply.code))

    def arm(self, purpose: Any = "all") -> None:
        """Clear latched faults and arm."""
        self.send_request(topics.CLEAR, Empty())
        self.send_request(topics.ARM, ArmRequest(purpose=purpose))

    def begin(self) -> None:
        """Advance past the preflight, tare, arm."""
        self.wait(1.3 if self.wire is None else 1.7)
        self.send_request(topics.TARE, Empty())
        self.arm()

    def force(self, mode: Any = "position", setpoint_N: float = 20.0, **more: Any) -> None:
        """Start force feedback."""
        start = ForceStartRequest(mode=mode, setpoint_N=setpoint_N, **more)
        self.send_request(topics.FORCE_START, start)

    def confirm_axes(self) -> None:
        """Confirm axes and signs, as `forcemesh check axes` does."""
        wrench = self.cell.client.reader(topics.WRENCH)
        self.wait(0.05)
        newest = wrench.read(self.cell.clock.now_ns()).message
        assert newest is not None
        self.send_request(topics.AXES, AxesRequest(calibration=newest.calibration))

    def hold(self) -> None:
        """Hold, and record the result for 0.2 s."""
        self.send_request(topics.HOLD, HoldRequest())
        self.wait(0.2)

    def move(self, **request: Any) -> None:
        """Request a move."""
        self.send_request(topics.MOVE, MoveRequest(**request))

    def shifted_pose(
        self, *shift_m: float, turn_rad: tuple[float, ...] = (0.0, 0.0, 0.0)
    ) -> PoseRecord:
        """Return a flange pose shifted from the present one, base axes."""
        state = self._robot.read(self.cell.clock.now_ns()).message
        assert isinstance(state, RobotState)
        T = pose_of(state)
        T.translation = T.translation + np.array(shift_m)
        T.rotation = rotation_from_vector(np.array(turn_rad)) @ T.rotation
        return record_of(T)

    # --- faults -----------------------------------------------------------------------------------

    def disturb(self, change: Callable[[FtSample], FtSample | None] | None) -> None:
        """Change the sensor's samples from now on; None: no change."""
        self.cell.arm.ft_sensor.disturb = change or (lambda sample: sample)

    def freeze(self, role: str, seconds: float) -> None:
        """Stop a process for a time, then continue it."""
        runner = self.cell.runners.pop(role)
        self.wait(seconds)
        # At its place again: roles are stepped in the order of their start.
        runners = self.cell.runners | {role: runner}
        self.cell.runners.clear()
        self.cell.runners.update({name: runners[name] for name in ORDER if name in runners})

    def stall(self, direction: str, seconds: float) -> None:
        """Stall one direction of the wire from now on."""
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
        """Apply a force of a hand to the tool, base axes."""
        body = self.cell.arm.model.body("tool").id
        self.cell.arm.data.xfrc_applied[body, :3] = force_N


def shifted(*by: float) -> Callable[[FtSample], FtSample]:
    """Return a function that adds six numbers to each reading."""
    add = np.array(by)

    def change(sample: FtSample) -> FtSample:
        force_N, torque_Nm = sample.force_N + add[:3], sample.torque_Nm + add[3:]
        return replace(sample, force_N=force_N, torque_Nm=torque_Nm)

    return change

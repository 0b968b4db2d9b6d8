"""Virtual cell with an error in the sensor installation or in the cell file."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from bench.faults import CutTransport, FaultCell, cell_for
from bench.sensor_faults import STIFF_N_M
from cli.calibration.drive import Drive
from cli.calibration.gather import Gatherer
from common.bus.configured_cell import ConfiguredCell
from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import cell_from_tree
from common.motion.frames import (
    Array,
    Oat,
    R_from_oat,
    R_from_quaternion,
    oat_from_R,
    quaternion_from_R,
)
from forcemesh import topics
from forcemesh.codec import decode, encode
from forcemesh.errors import SimulationError
from forcemesh.messages import RobotState
from forcemesh.requests import MoveRequest
from forcemesh.topics import Qos
from identification.dwells import Dwell, samples_of
from identification.excitation.plan import CalibrationPlan, PlanOptions, make_plan
from identification.recording import Samples
from launch.virtual_cell import VirtualCell
from sim.robot.arm import SimArm
from sim.robot.ft_sensor import FtSample
from sim.robot.service import SimRobot

EYE = np.eye(3)
COM_M = [0.012, -0.008, 0.055]
POSES, DWELL_S, SPEED_M_S = 6, 0.2, 0.25
TURN_DEG = (0.0, 0.0, 0.0, 0.0, 70.0, 0.0)  # of the wrist, by hand, before arming
GAP_M = 0.001
REST_S = 0.6


@dataclass(frozen=True)
class InstallationError:
    """One installation error: channel matrix, changes of the cell file, reported attitudes."""

    name: str
    group: str
    force: Array = field(default_factory=lambda: EYE)
    torque: Array = field(default_factory=lambda: EYE)
    changes: dict[str, Any] = field(default_factory=dict)  # of the cell file, by dotted key
    attitude: Callable[[Array], Array] | None = None  # reported for an orientation

    @property
    def wiring(self) -> Array:
        """Matrix from the load to the six channels. Shape (6, 6)."""
        both = np.zeros((6, 6))
        both[:3, :3], both[3:, 3:] = self.force, self.torque
        return both

    @property
    def of_sensor(self) -> bool:
        """Whether the error is in the sensor."""
        return not (np.array_equal(self.force, EYE) and np.array_equal(self.torque, EYE))


def true_cell() -> CellConfig:
    """Return the demo's cell, with a plate close to the tool, and the correct payload."""
    cell = cell_for("sim", gap_m=GAP_M, stiffness_N_m=STIFF_N_M)
    return changed(cell, {"payload.com_m": COM_M, "sim.tool_com_m": COM_M})


def bias_of(cell: CellConfig) -> Array:
    """Return the reading of the simulated sensor without load. Raises SimulationError."""
    if cell.sim is None:
        raise SimulationError("the cell file has no section `sim`")
    return np.array([*cell.sim.bias_force_N, *cell.sim.bias_torque_Nm])


def changed(cell: CellConfig, changes: dict[str, Any]) -> CellConfig:
    """Return a cell with other entries, by their dotted keys."""
    tree = cell.model_dump(mode="json")
    for key, value in changes.items():
        *path, last = key.split(".")
        section = tree
        for name in path:
            section = section[name]
        section[last] = value
    return cell_from_tree(tree, "a cell with a mistake")


def attitude_times(R: Array, times: float) -> Array:
    """Return the orientation whose O, A, T are scaled by a factor."""
    return R_from_oat(Oat(*(times * angle for angle in oat_from_R(R))))


class AttitudeErrorTransport(CutTransport):
    """Bus on which the robot reports a wrong orientation."""

    def __init__(self, attitude: Callable[[Array], Array] | None) -> None:
        """Change nothing without a function."""
        super().__init__()
        self._attitude = attitude

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that puts bytes on a key."""
        put, bend = super().publish(key, qos), self._attitude
        if bend is None or not key.endswith(topics.ROBOT_STATE.key):
            return put

        def put_bent(data: bytes) -> None:
            header, state = decode(data, RobotState)
            R = bend(R_from_quaternion(state.orientation_xyzw))
            bent = state.replaced(orientation_xyzw=quaternion_from_R(R))
            put(encode(header, bent))

        return put_bent


class MisinstalledCell(VirtualCell):
    """Cell whose processes use one cell file while arm and sensor follow another one."""

    def __init__(
        self, configured: CellConfig, true: CellConfig, transport: MemoryTransport
    ) -> None:
        """Start all services."""
        self._true = true
        super().__init__(configured, transport)

    def _add_sim(self) -> SimArm:
        bus = self._bus("robot")
        robot = SimRobot(bus, self._true)
        self._add("robot", robot, bus, bus.playing("sensor"))
        return robot.arm


class Stage(FaultCell):
    """Cell with an error, just started: neither tared nor armed."""

    def __init__(self, mistake: InstallationError, *, hidden: bool = False) -> None:
        """Start it; hidden: the error is removed from the reading at rest, as by a tare."""
        true = true_cell()
        self.bus = AttitudeErrorTransport(mistake.attitude)
        self.world = MisinstalledCell(changed(true, mistake.changes), true, self.bus)
        self.host = "pc"
        self.p_m = []
        self.last_ns = 0
        sensor = self.world.arm.ft_sensor
        if mistake.of_sensor and hidden:
            sensor.disturb = tared_sensor(self.world.arm.ft_sensor.sample(), mistake.wiring)
        else:
            sensor.wiring = mistake.wiring
        self.world.advance(1.6)

    def turn_wrist(self) -> None:
        """Jog the wrist by hand, then rest. Raises ForcemeshError with the cause of a stop."""
        drive = Drive(ConfiguredCell(self.world.cell, bus=self.world.client), SPEED_M_S)
        drive.arm()
        q = drive.state().joint_rad + np.radians(TURN_DEG)
        request = MoveRequest(kind="joints", joint_rad=tuple(q.tolist()), speed_m_s=SPEED_M_S)
        self.ask(topics.MOVE, request)
        self.world.advance(6.0, lambda: bool(np.abs(drive.state().joint_rad - q).max() < 1e-3))
        drive.release()
        self.world.advance(REST_S + 1.0)


def tared_sensor(rest: FtSample, wiring: Array) -> Callable[[FtSample], FtSample]:
    """Return a sensor with the correct reading at rest whose changes pass through a wiring."""
    at_rest = np.concatenate((rest.force_N, rest.torque_Nm))

    def disturb(sample: FtSample) -> FtSample:
        grown = np.concatenate((sample.force_N, sample.torque_Nm)) - at_rest
        shown = at_rest + wiring @ grown
        return FtSample(shown[:3], shown[3:], sample.status, sample.counter)

    return disturb


@cache
def plan_of() -> CalibrationPlan:
    """Return the six poses of the automatic check, from the initial pose of the demo's arm."""
    stage = Stage(InstallationError("none", ""))
    arm = stage.world.arm
    return make_plan(stage.world.cell, arm.kinematics, np.array(arm.q), PlanOptions(POSES, 1))


def gather(mistake: InstallationError) -> Samples:
    """Move through the poses of the check; return the readings with this error."""
    stage, plan = Stage(mistake), plan_of()
    cell, route = ConfiguredCell(stage.world.cell, bus=stage.world.client), plan.route
    drive, gatherer = Drive(cell, SPEED_M_S), Gatherer(cell)
    gatherer.until_received()
    drive.arm()
    at, dwells = route.q_start, list[Dwell]()
    for place in plan.fit:
        hub = [] if dwells else route.goals_to_hub(at)
        for q in [*hub, *route.goals(hub[-1] if hub else at, plan.q[place])]:
            drive.move_joints(q, route.length_m(at, q), lambda _: None)
            at = q
        dwells.append(gatherer.dwell("fit", DWELL_S, lambda _: None))
    return samples_of(dwells)


@cache
def gathered() -> Samples:
    """Return the readings of a correct installation, to which each error is applied."""
    return gather(InstallationError("none", ""))


def readings_with(mistake: InstallationError) -> Samples:
    """Return the readings of the check with an error; equal to a new run with it."""
    rows, true = gathered(), true_cell()
    configured = changed(true, mistake.changes)
    bias = bias_of(true)
    load = np.concatenate((rows.force_N, rows.torque_Nm), axis=1) - bias
    shown = load @ mistake.wiring.T + bias
    R_true, R_configured = (
        np.asarray(cell.sensor.T_flange_sensor.pose.rotation) for cell in (true, configured)
    )
    R_base_flange = rows.R_base_sensor @ R_true.T
    if mistake.attitude is not None:
        R_base_flange = np.array([mistake.attitude(R) for R in R_base_flange])
    return Samples(R_base_flange @ R_configured, shown[:, :3], shown[:, 3:], rows.time_s)

"""Sensor installation errors in virtual cells, and their detection.

Three lines of defence are tested, each as if the previous ones had been skipped:
- `check axes`: the readings in six poses, as this installation shows them;
- arming: tare, rotate the wrist by hand, `arm` for force;
- the press: the error is hidden at rest, then the tool is pressed on a plate.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from math import isfinite
from typing import Any

import numpy as np

from bench.faults import cell_for
from bench.harness import CaseTable, Options, Tables, grouped
from bench.results import Row
from bench.sensor_faults import GAP_M, PRESSED_N, STIFF_N_M, name_of, tared_sensor, until_held
from cli.calibration.drive import Drive
from cli.calibration.gather import Gatherer
from common.bus.configured_cell import ConfiguredCell
from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
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
from forcemesh.errors import ConfigError, ForcemeshError, RefusedError
from forcemesh.messages import RobotState
from forcemesh.requests import ArmRequest, Empty, MoveRequest
from forcemesh.topics import Qos
from identification.dwells import Dwell, samples_of
from identification.excitation.plan import CalibrationPlan, PlanOptions, make_plan
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation
from identification.recording import Samples
from launch.virtual_cell import VirtualCell
from sim.robot.arm import SimArm
from sim.robot.service import SimRobot

EYE = np.eye(3)
COM_M = [0.012, -0.008, 0.055]
POSES, DWELL_S, SPEED_M_S = 6, 0.2, 0.25
TURN_DEG = (0.0, 0.0, 0.0, 0.0, 70.0, 0.0)  # of the wrist, by hand, before arming
TURNED_REST_S = 1.6


@dataclass(frozen=True)
class InstallationError:
    """One installation error: channels, changes of the cell file, reported attitudes."""

    name: str
    group: str
    wiring: Array = field(default_factory=lambda: np.eye(6))  # from the load to the six channels
    changes: dict[str, Any] = field(default_factory=dict)  # of the cell file, by dotted key
    attitude: Callable[[Array], Array] | None = None  # reported for an orientation


def channels(force: Array, torque: Array) -> Array:
    """Return the wiring of force and torque, shapes (3, 3), to the six channels. Shape (6, 6)."""
    both = np.zeros((6, 6))
    both[:3, :3], both[3:, 3:] = force, torque
    return both


def cell_with(changes: Mapping[str, Any]) -> CellConfig:
    """Return the demo's cell, with a plate close to the tool, the correct payload, and changes."""
    correct = {"sim.gap_m": GAP_M, "payload.com_m": COM_M, "sim.tool_com_m": COM_M}
    return cell_for("sim", STIFF_N_M, {**correct, **changes})


def attitude_times(R: Array, times: float) -> Array:
    """Return the orientation whose O, A, T are scaled by a factor."""
    return R_from_oat(Oat(*(times * angle for angle in oat_from_R(R))))


class AttitudeErrorTransport(MemoryTransport):
    """Bus on which the robot reports a wrong orientation."""

    def __init__(self, attitude: Callable[[Array], Array] | None) -> None:
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
            put(encode(header, state.replaced(orientation_xyzw=quaternion_from_R(R))))

        return put_bent


class MisinstalledCell(VirtualCell):
    """Cell with an error, just started, whose arm and sensor follow another cell file."""

    def __init__(self, mistake: InstallationError, *, hidden: bool = False) -> None:
        """Start it; hidden: the error is removed from the reading at rest, as by a tare."""
        self._true, configured = cell_with({}), cell_with(mistake.changes)
        super().__init__(configured, AttitudeErrorTransport(mistake.attitude))
        self.program = ConfiguredCell(configured, commander="operator", bus=self.client)
        if hidden and not np.array_equal(mistake.wiring, np.eye(6)):
            self.arm.ft_sensor.disturb = tared_sensor(self, mistake.wiring)
        else:
            self.arm.ft_sensor.wiring = mistake.wiring
        self.advance(1.6)

    def _add_sim(self) -> SimArm:
        bus = self._bus("robot")
        robot = SimRobot(bus, self._true)
        self._add("robot", robot, bus, bus.playing("sensor"))
        return robot.arm

    def refusal(self, request: topics.Request[Any], message: Any) -> str:
        """Return why a request is refused, empty if it is not."""
        try:
            self.program.ask(request, message)
        except RefusedError as error:
            return f"{error.code}: {error.text}"
        return ""

    def turn_wrist(self) -> None:
        """Jog the wrist by hand, then rest. Raises ForcemeshError with the cause of a stop."""
        drive = Drive(self.program, SPEED_M_S)
        drive.arm()
        q = drive.state().joint_rad + np.radians(TURN_DEG)
        request = MoveRequest(kind="joints", joint_rad=tuple(q.tolist()), speed_m_s=SPEED_M_S)
        self.program.ask(topics.MOVE, request)
        self.advance(6.0, lambda: bool(np.abs(drive.state().joint_rad - q).max() < 1e-3))
        drive.release()
        self.advance(TURNED_REST_S)


@cache
def plan_of() -> CalibrationPlan:
    """Return the six poses of the automatic check, from the initial pose of the demo's arm."""
    world = MisinstalledCell(InstallationError("none", ""))
    arm = world.arm
    return make_plan(world.cell, arm.kinematics, np.array(arm.q), PlanOptions(POSES, 1))


def gather(mistake: InstallationError) -> Samples:
    """Move through the poses of the check; return the readings with this error."""
    cell, plan = MisinstalledCell(mistake).program, plan_of()
    route, drive, gatherer = plan.route, Drive(cell, SPEED_M_S), Gatherer(cell)
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
    rows, true, configured = gathered(), cell_with({}), cell_with(mistake.changes)
    assert true.sim is not None  # noqa: S101 - the demo's is simulated
    bias = np.array([*true.sim.bias_force_N, *true.sim.bias_torque_Nm])
    load = np.concatenate((rows.force_N, rows.torque_Nm), axis=1) - bias
    shown = load @ mistake.wiring.T + bias
    R_true, R_configured = (
        np.asarray(cell.sensor.T_flange_sensor.pose.rotation) for cell in (true, configured)
    )
    R_base_flange = rows.R_base_sensor @ R_true.T
    if mistake.attitude is not None:
        R_base_flange = np.array([mistake.attitude(R) for R in R_base_flange])
    return Samples(R_base_flange @ R_configured, shown[:, :3], shown[:, 3:], rows.time_s)


PRESS_S, REST_S, MOST_N = 6.0, 0.1, 10.0
NO_CELL = "nothing starts"
ALL, FORCES, TORQUES, UNITS = "all six channels", "forces", "torques", "units and payload"
KGF, LBF = 1.0 / 9.80665, 1.0 / 4.4482216


def wirings(group: str) -> Iterator[InstallationError]:
    """Yield the 47 wrong wirings of some channels."""
    for wiring in SIGNED[1:]:
        force = EYE if group == TORQUES else wiring
        torque = EYE if group == FORCES else wiring
        yield InstallationError(name_of(wiring), group, channels(force, torque))


FACTORS = {  # of forces, of torques
    "none: all correct": (1.0, 1.0),
    "forces in kgf": (KGF, 1.0),
    "forces in pounds": (LBF, 1.0),
    "forces and torques in kgf, kgf m": (KGF, KGF),
    "forces multiplied by 9.81": (1.0 / KGF, 1.0),
    "torques in N mm": (1.0, 1e3),
    "torques in inch-pounds": (1.0, 8.8507458),
}
OAT = "sensor.T_flange_sensor.oat_deg"
IN_MM = {
    "tool.T_flange_tcp.position_m": [0.0, 0.0, 160.0],
    "sensor.T_flange_sensor.position_m": [0.0, 0.0, 20.0],
    "payload.com_m": [12.0, -8.0, 55.0],
}


def others() -> Iterator[InstallationError]:
    """Yield wrong units and payloads."""
    for name, (force, torque) in FACTORS.items():
        yield InstallationError(name, UNITS, channels(force * EYE, torque * EYE))
    for name, times in (
        ("attitudes: degrees for radians", np.degrees(1.0)),
        ("attitudes: radians for degrees", np.radians(1.0)),
    ):
        yield InstallationError(name, UNITS, attitude=partial(attitude_times, times=times))
    oat_deg = [round(float(np.radians(30.0)), 4), 0.0, 0.0]
    changes: dict[str, dict[str, Any]] = {"oat_deg of the sensor in radians": {OAT: oat_deg}}
    changes |= {f"{key} in mm": {key: value} for key, value in IN_MM.items()}
    for factor in (0.8, 1.2):
        changes[f"payload.mass_kg: {factor:g} of the true value"] = {"payload.mass_kg": factor}
    for axis, off_m in zip("xyz", 0.02 * EYE, strict=True):
        com_m = {"payload.com_m": (np.array(COM_M) + off_m).tolist()}
        changes[f"payload.com_m 20 mm off in {axis}"] = com_m
    for name, change in changes.items():
        yield InstallationError(name, UNITS, changes=change)


def row(mistake: InstallationError) -> Row:
    """Test the lines of defence that are relevant for a group.

    Torques have no effect on a straight press; errors of the forces press like all six channels.
    """
    found: Row = {"group": mistake.group, "error": mistake.name}
    try:
        configured = cell_with(mistake.changes)
    except ConfigError as error:
        refusal = f"the cell file is refused: {'; '.join(error.mistakes)}"
        refused = {"result": refusal, "tare": NO_CELL, "arming": NO_CELL, "press": ""}
        return {**found, "detected": True, "harmless": True, **refused}
    judged = judge_installation(readings_with(mistake), ExpectedInstallation.of(configured))
    tare, arming = ("", "") if mistake.group == FORCES else _arming(mistake)
    press = {} if mistake.group in (FORCES, TORQUES) else _press(mistake)
    return {
        **found,
        "detected": judged.verdict == "wrong",
        "result": ". ".join(map(str, judged.findings)) or judged.verdict,
        "tare": short(tare),
        "arming": short(arming),
        **press,
    }


def _arming(mistake: InstallationError) -> tuple[str, str]:
    """Return why the tare, and arming for force with a rotated wrist, were refused."""
    world = MisinstalledCell(mistake)
    tare = world.refusal(topics.TARE, Empty())
    try:
        world.turn_wrist()
    except ForcemeshError as error:
        return tare, f"jog: {error}"
    return tare, world.refusal(topics.ARM, ArmRequest())


def _press(mistake: InstallationError) -> Row:
    """Return why the press was stopped, its true peak force and its travel."""
    world = MisinstalledCell(mistake, hidden=True)
    world.refusal(topics.TARE, Empty())
    world.advance(REST_S)
    if refused := world.refusal(topics.ARM, ArmRequest()):
        return {"press": f"not armed: {refused.partition(': ')[2]}", "harmless": True}
    try:
        world.program.force.start(PRESSED_N)
    except ForcemeshError as error:
        return {"press": f"not started: {error}", "harmless": True}
    found = until_held(world, PRESS_S)
    stopped = f"{found['code']} after {1e3 * found['held_s']:.0f} ms"
    return {
        **found,
        "press": stopped if isfinite(found["held_s"]) else "",
        "harmless": found["peak_N"] < MOST_N,
    }


def short(answer: str) -> str:
    """Return the first reason of an answer, without code and advice."""
    words = answer.split(": ")
    return answer if len(words) < 3 else words[1]


ROWS = CaseTable([*others(), *wirings(ALL), *wirings(FORCES), *wirings(TORQUES)], row)


def measure(options: Options) -> Tables:
    """Return every error, and how many of each group each line of defence finds."""
    rows = ROWS.measured(options)
    hard = [each for each in rows if not each.get("harmless", True)]
    return {"summary": summary(rows), "hard-presses": hard, "rows": rows}


def summary(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the counts of a group; a line of defence that was not played has none."""
    wrong = [row for row in rows if not row["error"].startswith("none")]
    for place, ours in grouped(wrong, "group"):
        refused = [bool(each["tare"] or each["arming"]) for each in ours]
        harmless = [each.get("harmless", False) for each in ours]
        found = [each["detected"] for each in ours]
        passed = sum(not any(each) for each in zip(found, refused, harmless, strict=True))
        group = place["group"]
        yield {
            "group": group,
            "errors": len(ours),
            "detected_by_the_check": sum(found),
            "tare_or_arming_refused": None if group == FORCES else sum(refused),
            "harmless_press": None if group in (FORCES, TORQUES) else sum(harmless),
            "none_of_these": passed,
            "met": passed == 0,
        }

"""Tasks per axis: three force set points on a coupled contact, and a change of frame and axes.

The tool is held in a bushing whose stiffness is diagonal in none of the frames
(tests/fakes/coupled_contact.py): each axis feels the motion along the others. Tasks, first set
points and their ramp are the product's own (services/regulator/task_request.py). A peer gets the
same set points; its motion along a held axis is zero, as with a stiff spring.
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from math import nan
from typing import Any

import numpy as np
import pinocchio as pin

from bench.force.measures import means, settling_s
from bench.force.peers import Admittance, Fdcc
from bench.force.rig import ForceRig, LawSample, SceneSettings, Trace
from bench.force.run import Row
from bench.force.settle import true_tau_s
from common.motion.convert import vec3
from common.motion.frames import Array
from forcemesh.force_task import parse_task
from forcemesh.messages import PoseRecord, TaskFrame
from forcemesh.requests import ForceStartRequest
from services.regulator.axis_task import AxisTask, masked
from services.regulator.gains import PiGains
from services.regulator.law import LawInput, back_calculate, start_at
from services.regulator.laws import LAWS as PRODUCT_LAWS
from services.regulator.task_request import (
    first_setpoint,
    next_setpoint,
    ramped,
    request_task,
    same_frame,
)
from tests.fakes.coupled_contact import CoupledContact, skewed_stiffness
from tuning.gain_rule import tune

LAWS = ("adaptive", "plain, known k", "admittance, known k", "FDCC-like, known k")
STIFFNESSES_N_M, LOOPS_HZ = (5e3, 2e4, 1e5), (250.0, 60.0, 30.0)
SHARES = (1.0, 0.7, 0.5)  # principal stiffnesses, of the largest
LEVER_M = 0.026  # of the stiffness against rotation
BUSHINGS = (0, 1, 2)  # drawn axes
DELAY_MS, GAP_M = 10, 0.08  # far above the plate
PEER_TIME_S = 0.01  # second parameter of both peers
HELD_TURN = " rx=held ry=held rz=held"
THREE = "x=force:5 y=force:-4 z=force:10" + HELD_TURN
ONE = "z=force:10"
TWO = "x=held y=force:-5 z=force:12" + HELD_TURN
BAND_N, TAIL_S = 1.0, 1.0
SETTLES_S, CHANGE_S = 5.0, 1.0
TURNED = pin.utils.rotate("z", 0.7) @ pin.utils.rotate("x", 0.4)  # axes of the changed frame


@dataclass(frozen=True, slots=True)
class AxisScene:
    """One law in one scene, in one bushing."""

    scene: str
    law: str
    world: SceneSettings
    bushing: int


class TaskPilot:
    """A law with a task: its set points are ramped as the regulator does it."""

    goal: AxisTask
    task: AxisTask

    def __init__(self, rig: ForceRig) -> None:
        """Start without a task, at rest."""
        self.rig, self._begun = rig, False

    def start(self, text: str, frame: TaskFrame = "base", pose: PoseRecord | None = None) -> None:
        """Start or change a task: the set points of a new frame begin at the present load."""
        wrench, T = self.rig.wrench(), self.rig.arm.T_base_tcp
        request = ForceStartRequest(task=parse_task(text, frame, pose))
        mounting_rad = self.rig.payload.mounting_rotation_rad
        goal = request_task(request, T, self.rig.cell, mounting_rad=mounting_rad)
        first = first_setpoint(goal, wrench.force_N, wrench.torque_Nm, T)
        is_same = self._begun and same_frame(self.goal, goal)
        self.goal, self._begun = goal, True
        self.task = next_setpoint(self.task, first) if is_same else first
        if not is_same:
            self.restart()

    def restart(self) -> None:
        """Begin in another frame."""

    def ramp(self, dt_s: float) -> AxisTask:
        """Return the task of this period."""
        self.task = ramped(self.task, self.goal, self.rig.cell.force.setpoint_ramp_N_s * dt_s)
        return self.task


class ProductPilot(TaskPilot):
    """A law of the regulator."""

    def __init__(self, rig: ForceRig, law: str, gain_m_per_Ns: float | None = None) -> None:
        """Start with the rule's gains, or one tuned by hand."""
        super().__init__(rig)
        self._law, self._gains = PRODUCT_LAWS[law], PiGains.of(tune(rig.cell).gains)
        if gain_m_per_Ns is not None:
            self._gains = replace(
                self._gains, force_i_m_per_Ns=(gain_m_per_Ns,) * 3, force_p_m_per_N=(0.0,) * 3
            )
        self._settings = self._law.settings(rig.cell)
        self._motion, self._state = start_at(rig.T_base_tcp), None

    def restart(self) -> None:
        """Forget the estimates along the axes of the frame before, and its errors."""
        self._motion = replace(self._motion, error_force_N=None, error_torque_Nm=None)
        T_command, T_measured = self._motion.T_base_tcp, self.rig.arm.T_base_tcp
        self._state = self._law.begin(T_command, T_measured, None, self._settings)

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        motion = self._motion
        if law_sample.limited:
            motion = back_calculate(motion, law_sample.T_let_through)
        sample = LawInput(
            vec3(law_sample.force_N),
            vec3(law_sample.torque_Nm),
            self.ramp(law_sample.dt_s),
            law_sample.dt_s,
            self._gains,
            motion,
            law_sample.T_base_tcp,
        )
        self._state, self._motion = self._law.step(self._state, sample, self._settings)
        return self._motion.T_base_tcp


class PeerPilot(TaskPilot):
    """A peer's law, given the error along the axes that the task controls."""

    def __init__(self, rig: ForceRig, law: Admittance | Fdcc) -> None:
        """Start at rest."""
        super().__init__(rig)
        self._law = law  # its own set point stays zero: it acts along one axis only

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        task, T = self.ramp(law_sample.dt_s), law_sample.T_base_tcp
        R = task.R_base_task(T.rotation.tolist())
        error_N = law_sample.force_N + np.array(R) @ task.force_N
        error_N = np.array(masked(vec3(error_N), task.yields, R))
        return self._law.step(replace(law_sample, force_N=error_N))


def three_axes(pilot: ProductPilot | PeerPilot) -> dict[str, float]:
    """Take three force set points at once, from no load; the rotation is held."""
    T_start = pilot.rig.arm.T_base_tcp
    pilot.start(THREE)
    trace = pilot.rig.run(pilot, SETTLES_S)
    return _reached(pilot, trace) | {"held_deg": _turned_deg(trace, T_start)}


def task_change(pilot: ProductPilot | PeerPilot) -> dict[str, float]:
    """From one axis in base to a turned frame at the present loads, then to other axes of it."""
    rig = pilot.rig
    pilot.start(ONE)
    before = rig.run(pilot, SETTLES_S)
    load_N = np.mean([f for t, f in _rows(before) if t >= SETTLES_S - TAIL_S], axis=0)
    along_N = -TURNED.T @ load_N
    T = rig.arm.T_base_tcp
    pose = PoseRecord(
        position_m=vec3(T.translation),
        orientation_xyzw=tuple(pin.Quaternion(TURNED).coeffs().tolist()),
    )
    axes = " ".join(f"{name}=force:{f:.3f}" for name, f in zip("xyz", along_N, strict=True))
    pilot.start(axes + HELD_TURN, "pose", pose)
    changed = rig.run(pilot, CHANGE_S)
    T_start = rig.arm.T_base_tcp
    pilot.start(TWO, "pose", pose)
    trace = rig.run(pilot, SETTLES_S)
    away_m = [abs(TURNED[:, 0] @ (T.translation - T_start.translation)) for T in trace.T_base_tcp]
    return {
        "bump_N": float(max(_smooth(changed, np.array(changed.force_N) - load_N))),
        **_reached(pilot, trace),
        "held_mm": 1e3 * float(max(away_m)),
    }


SCENES = {"three axes": three_axes, "change of task": task_change}


def _reached(pilot: TaskPilot, trace: Trace) -> dict[str, float]:
    """Return how the controlled axes came to their set points."""
    t, goal = np.array(trace.t_s), pilot.goal
    R = np.array(goal.R_base_task(pilot.rig.arm.T_base_tcp.rotation.tolist()))
    exerted_N = -np.array(trace.force_N) @ R
    error_N = (exerted_N - goal.force_N)[:, np.array(goal.yields)]
    beyond_N = -error_N * np.sign(error_N[0])  # in the direction of the change
    over_N = max(float(means(t, column).max()) for column in beyond_N.T)
    settled = settling_s(t, _smooth(trace, error_N), BAND_N)
    return {
        "settling_s": nan if settled is None else settled,
        "overshoot_N": max(0.0, over_N),
        "steady_error_N": float(np.abs(error_N[t >= t[-1] - TAIL_S]).mean(axis=0).max()),
    }


def _smooth(trace: Trace, vectors: Array) -> Array:
    """Return the size of vectors in means of 8 ms. Shape (n,)."""
    t = np.array(trace.t_s)
    return np.asarray(np.linalg.norm([means(t, column) for column in vectors.T], axis=0))


def _rows(trace: Trace) -> list[tuple[float, Array]]:
    return [*zip(trace.t_s, trace.force_N, strict=True)]


def _turned_deg(trace: Trace, T_start: pin.SE3) -> float:
    turned = (pin.log3(T.rotation @ T_start.rotation.T) for T in trace.T_base_tcp)
    return float(np.degrees(max(np.linalg.norm(turn) for turn in turned)))


def axis_rows(pool: Executor, *, quick: bool) -> list[Row]:
    """Return our law in every scene, and the others where the loop is fast.

    `quick`: one stiffness, loop and bushing.
    """
    places = [(2e4, 250.0)] if quick else [*product(STIFFNESSES_N_M, LOOPS_HZ)]
    jobs = [
        AxisScene(scene, law, SceneSettings(k, DELAY_MS, hz, gap_m=GAP_M), bushing)
        for scene, law, (k, hz) in product(SCENES, LAWS, places)
        for bushing in (BUSHINGS[:1] if quick else BUSHINGS)
        if law == "adaptive" or hz == LOOPS_HZ[0]
    ]
    return list(pool.map(axis_row, jobs))


def axis_row(scene: AxisScene) -> Row:
    """Return one row of the table."""
    row: Row = {
        "scene": scene.scene,
        "law": scene.law,
        "stiffness_N_m": scene.world.stiffness_N_m,
        "loop_hz": scene.world.loop_hz,
        "bushing": scene.bushing,
    }
    measures = SCENES[scene.scene](pilot_of(scene))
    return row | {name: None if np.isnan(value) else value for name, value in measures.items()}


def pilot_of(scene: AxisScene) -> ProductPilot | PeerPilot:
    """Return a law whose tool is in a bushing, without load."""
    world, k = scene.world, scene.world.stiffness_N_m
    rig = ForceRig(world.cell())
    along = tuple(share * k for share in SHARES)
    about = tuple(LEVER_M**2 * each for each in along)
    stiffness = skewed_stiffness(np.random.default_rng(scene.bushing), along, about)
    bushing: Any = CoupledContact(rig.arm, stiffness)
    rig.arm.plate = bushing
    if scene.law == "adaptive":
        return ProductPilot(rig, "adaptive")
    cell = rig.cell
    inertia = 0.5 / (cell.contact.inertia_kg * cell.robot.bandwidth_rad_s)
    gain = min(0.45 / (k * true_tau_s(world)), inertia)  # of the stiffest direction
    if scene.law.startswith("plain"):
        return ProductPilot(rig, "plain", gain)
    peer = Admittance if scene.law.startswith("admittance") else Fdcc
    law = peer(rig.T_base_tcp, gain, PEER_TIME_S, longest_m_s=cell.force.speed_max_m_s)
    return PeerPilot(rig, law)

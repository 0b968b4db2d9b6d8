"""Tasks per axis: three force set points on a coupled contact, and a change of frame and axes.

The tool is held in a bushing whose stiffness is diagonal in none of the frames
(tests/fakes/coupled_contact.py): each axis feels the motion along the others. Tasks, first set
points and their ramp are the product's own (services/regulator/task_request.py). A peer gets the
same set points; its motion along a held axis is zero, as with a stiff spring.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from bench.force.laws import LOOPS_HZ, AnyLaw, LawRunner, law_of, ours, places_of
from bench.force.requirements import requirement
from bench.force.rig import ForceRig, LawSample, SceneSettings, Trace, means, settling_s
from bench.harness import CaseTable, Options, Tables, grouped, largest, worst
from bench.results import Row
from common.motion.convert import vec3
from common.motion.frames import Array
from control.axis_task import AxisTask, masked
from forcemesh.force_task import parse_task
from forcemesh.messages import PoseRecord, TaskFrame
from forcemesh.requests import ForceStartRequest
from services.regulator.task_request import (
    first_setpoint,
    next_setpoint,
    ramped,
    request_task,
    same_frame,
)
from tests.fakes.coupled_contact import CoupledContact, skewed_stiffness

SHARES = (1.0, 0.7, 0.5)  # principal stiffnesses, of the largest
LEVER_M = 0.026  # of the stiffness against rotation
BUSHINGS = (0, 1, 2)  # drawn axes
DELAY_MS, GAP_M = 10, 0.08  # far above the plate
HELD_TURN = " rx=held ry=held rz=held"
THREE = "x=force:5 y=force:-4 z=force:10" + HELD_TURN
ONE = "z=force:10"
TWO = "x=held y=force:-5 z=force:12" + HELD_TURN
TAIL_S = 1.0
SETTLES_S, CHANGE_S = 5.0, 1.0
TURNED = pin.utils.rotate("z", 0.7) @ pin.utils.rotate("x", 0.4)  # axes of the changed frame
LIMITS = (  # table, measure, quantity, limit
    ("three-axes", "steady_error_N", "three axes, steady error, N", 0.1),
    ("three-axes", "held_deg", "three axes, rotation that is held, degrees", 0.2),
    ("change-of-task", "bump_N", "change of frame at the present loads, N", 1.0),
    ("change-of-task", "steady_error_N", "changed axes, steady error, N", 0.1),
    ("change-of-task", "held_mm", "changed axes, motion that is held, mm", 0.2),
)


class TaskPilot:
    """A law with a task: its set points are ramped as the regulator does it."""

    goal: AxisTask
    task: AxisTask

    def __init__(self, rig: ForceRig, law: AnyLaw) -> None:
        self.rig, self._law, self._begun = rig, law, False

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
        if not is_same and isinstance(self._law, LawRunner):
            self._law.restart()

    def step(self, sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose; a peer is given the error along the controlled axes."""
        rise_N = self.rig.cell.force.setpoint_ramp_N_s * sample.dt_s
        self.task = task = ramped(self.task, self.goal, rise_N)
        if isinstance(self._law, LawRunner):
            return self._law.step(sample, task)
        R = task.R_base_task(sample.T_base_tcp.rotation.tolist())
        error_N = sample.force_N + np.array(R) @ task.force_N
        error_N = np.array(masked(vec3(error_N), task.force_along, R))
        return self._law.step(replace(sample, force_N=error_N))


def three_axes(pilot: TaskPilot) -> Row:
    """Take three force set points at once, from no load; the rotation is held."""
    T_start = pilot.rig.arm.T_base_tcp
    pilot.start(THREE)
    trace = pilot.rig.run(pilot, SETTLES_S)
    turns = (pin.log3(T.rotation @ T_start.rotation.T) for T in trace.T_base_tcp)
    turned_deg = float(np.degrees(max(np.linalg.norm(turn) for turn in turns)))
    return {**_reached(pilot, trace), "held_deg": turned_deg}


def task_change(pilot: TaskPilot) -> Row:
    """From one axis in base to a turned frame at the present loads, then to other axes of it."""
    rig = pilot.rig
    pilot.start(ONE)
    before = rig.run(pilot, SETTLES_S)
    load_N = np.array(before.force_N)[np.array(before.t_s) >= SETTLES_S - TAIL_S].mean(axis=0)
    along_N = -TURNED.T @ load_N
    pose = PoseRecord(
        position_m=vec3(rig.arm.T_base_tcp.translation),
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
        **_reached(pilot, trace),
        "bump_N": float(max(_smooth(changed, np.array(changed.force_N) - load_N))),
        "held_mm": 1e3 * float(max(away_m)),
    }


def _reached(pilot: TaskPilot, trace: Trace) -> Row:
    """Return how the controlled axes came to their set points."""
    t, goal = np.array(trace.t_s), pilot.goal
    R = np.array(goal.R_base_task(pilot.rig.arm.T_base_tcp.rotation.tolist()))
    exerted_N = -np.array(trace.force_N) @ R
    error_N = (exerted_N - goal.force_N)[:, np.array(goal.force_along)]
    beyond_N = -error_N * np.sign(error_N[0])  # in the direction of the change
    return {
        "settling_s": settling_s(t, _smooth(trace, error_N)),
        "overshoot_N": max(0.0, *(float(means(t, column).max()) for column in beyond_N.T)),
        "steady_error_N": float(np.abs(error_N[t >= t[-1] - TAIL_S]).mean(axis=0).max()),
    }


def _smooth(trace: Trace, vectors: Array) -> Array:
    """Return the size of vectors in means of 8 ms. Shape (n,)."""
    t = np.array(trace.t_s)
    return np.asarray(np.linalg.norm([means(t, column) for column in vectors.T], axis=0))


def worst_of(case: Row, scene: Callable[[TaskPilot], Row]) -> Row:
    """Return a scene's measures, of each the worst of the bushings."""
    found = [scene(pilot_of(case, bushing)) for bushing in BUSHINGS]
    return {**case, **largest(found, found[0])}


def pilot_of(case: Row, bushing: int) -> TaskPilot:
    """Return a law whose tool is in a bushing, without load."""
    k = case["stiffness_N_m"]
    rig = ForceRig(SceneSettings(k, DELAY_MS, case["loop_hz"], gap_m=GAP_M).cell())
    along = tuple(share * k for share in SHARES)
    about = tuple(LEVER_M**2 * each for each in along)
    stiffness = skewed_stiffness(np.random.default_rng(bushing), along, about)
    plate: Any = CoupledContact(rig.arm, stiffness)
    rig.arm.plate = plate
    return TaskPilot(rig, law_of(case["law"], rig))


CASES = places_of(loop_hz=LOOPS_HZ, stiffness_N_m=(5e3, 2e4, 1e5))


TABLES = {
    "three-axes": CaseTable(CASES, partial(worst_of, scene=three_axes)),
    "change-of-task": CaseTable(CASES, partial(worst_of, scene=task_change)),
}


def measure(options: Options) -> Tables:
    """Return our law in every loop, the others where it is fast, and the requirements."""
    rows = {name: each.measured(options) for name, each in TABLES.items()}
    return {
        "requirements": requirements(rows),
        "worst": worst_by_rate(rows),
        **rows,
    }


def worst_by_rate(rows: dict[str, list[Row]]) -> Iterator[Row]:
    """Yield the worst of our law by scene and rate of the loop."""
    for scene, found in rows.items():
        for rate, these in grouped(ours(found), "loop_hz"):
            names = [name for name in these[0] if name not in ("law", "stiffness_N_m", "loop_hz")]
            yield {"scene": scene.replace("-", " "), **rate, **largest(these, names)}


def requirements(rows: dict[str, list[Row]]) -> Iterator[Row]:
    """Yield the requirements on our law in a fast loop; without rows none is met."""
    for name, measured_value, text, limit in LIMITS:
        found = (row[measured_value] for row in ours(rows[name]) if row["loop_hz"] == LOOPS_HZ[0])
        yield requirement(text, limit, worst(found))

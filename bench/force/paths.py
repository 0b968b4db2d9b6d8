"""Path with force: 10 N along poses on a tilted plane, a cylinder and a hemisphere.

The program is off, as one taught by hand or taken from CAD is: shifted, and turned about the place
where it starts. Every law runs the product's own path (services/regulator/pose_path.py), which
differs only in that a law with a predictor foresees the height by itself.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from math import nan

import numpy as np
import pinocchio as pin

from bench.force.measures import means
from bench.force.peers import Admittance, Fdcc
from bench.force.pilots import LawRunner
from bench.force.rig import ForceRig, LawSample, SceneSettings, Trace
from bench.force.run import Row
from bench.force.settle import true_tau_s
from bench.force.stage import HOLD_N, adaptive, tuned_plain
from common.motion.convert import vec3
from services.regulator.axis_task import mode_task
from services.regulator.gains import PiGains
from services.regulator.law import LawInput, LawMotion, back_calculate, start_at
from services.regulator.path_curve import PathCurve
from services.regulator.path_request import turn_limits
from services.regulator.pose_path import PosePath, path_start
from tuning.gain_rule import tune

SURFACES = ("plane", "cylinder", "hemisphere")
SPEEDS_M_S, STIFFNESSES_N_M, LOOPS_HZ = (0.005, 0.02, 0.05), (5e3, 2e4, 1e5), (250.0, 60.0, 30.0)
LAWS = ("adaptive", "plain, known k", "admittance, known k", "FDCC-like, known k")
TILT_DEG, RADIUS_M, DISC_RADIUS_M = 8.0, 0.08, 0.01
LENGTH_M, POSES = 0.04, 25  # out, and back again
OFF_M, OFF_RAD = (0.001, 0.001, 0.001), np.radians(2.0)  # of the program, at its start and about y
ACCEL_M_S2 = 0.3
PROMISED = (0.02, 2e4, 250.0)  # speed, stiffness and loop that are promised
PEER_TIME_S = 0.01  # second parameter of both peers
REACHED_S, LONGEST_S, COUNTED_FROM_S = 2.0, 25.0, 1.0
MOST_M_S = 0.15  # of force control and path together
NO_GAINS = PiGains.of(tune(SceneSettings().cell()).gains)  # the path uses none
PRESS_ONLY = (False, False, True, False, False, False)


@dataclass(frozen=True, slots=True)
class PathScene:
    """One law on one path."""

    law: str
    surface: str
    speed_m_s: float
    world: SceneSettings


class OnPath:
    """A law whose tool also moves along a path; without a path it only presses."""

    def __init__(self, law: LawRunner | Admittance | Fdcc, rig: ForceRig) -> None:
        """Start at rest; the path turns as fast as the cell permits, as in the regulator."""
        self.law, self._motion = law, start_at(rig.T_base_tcp)
        curve = PathCurve(rig.T_base_tcp, 0.0, ACCEL_M_S2, turn_limits(rig.cell))
        predicts = isinstance(law, LawRunner) and law.predicts
        self.path = PosePath(curve, in_contact=True, predicts=predicts)
        self._task = mode_task("position", HOLD_N, axes=PRESS_ONLY)
        law.setpoint_N = HOLD_N

    def begin(self, poses: Sequence[pin.SE3], speed_m_s: float) -> None:
        """Begin a path that leads to its first pose and on."""
        T_start = path_start(self._motion.T_base_tcp, poses[0], self._task)
        curve = replace(self.path.curve, T_joined=T_start, feed_m_s=speed_m_s)
        self.path = replace(self.path, curve=curve.extended(poses, 0.0))

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        T_before = law_sample.T_let_through
        if law_sample.limited:
            self._motion = back_calculate(self._motion, T_before)
        motion = self._pressed(law_sample)
        if self.path.pending:
            sample = LawInput(
                vec3(law_sample.force_N), vec3(law_sample.torque_Nm), self._task,
                law_sample.dt_s, NO_GAINS, self._motion, law_sample.T_base_tcp,
            )  # fmt: skip
            most_m = MOST_M_S * law_sample.dt_s
            self.path, motion.T_base_tcp, _ = self.path.follow(sample, motion, most_m)
        self._motion = motion
        self.law.place(motion.T_base_tcp)
        return motion.T_base_tcp

    def _pressed(self, sample: LawSample) -> LawMotion:
        """Return the motion of the law alone, along the tool's axis."""
        T_before = self._motion.T_base_tcp
        T = self.law.step(sample)
        if isinstance(self.law, LawRunner):
            return replace(self.law.motion)
        axis = T_before.rotation[:, 2]
        shift_m = float((T.translation - T_before.translation) @ axis) * axis
        press_N = -float(sample.force_N @ axis)
        return LawMotion(
            pin.SE3(T_before.rotation, T_before.translation + shift_m),
            error_force_N=vec3((HOLD_N - press_N) * axis),
            contact="contact" if press_N > 1.0 else "approach",
        )


def played(scene: PathScene) -> tuple[ForceRig, OnPath, Trace]:
    """Play one scene; return its rig, its law and what happened on the path."""
    rig = ForceRig(_world(scene).cell())
    rig.press(3.0)
    pilot = OnPath(_law(scene, rig), rig)
    rig.run(pilot, REACHED_S if scene.law == "adaptive" else 2.0 * REACHED_S)
    pilot.begin(list(programmed(rig, scene.surface)), scene.speed_m_s)
    trace = rig.run(pilot, 0.1)
    while pilot.path.pending and trace.t_s[-1] < LONGEST_S:
        rig.run(pilot, 0.1, trace)
    return rig, pilot, trace


def path_measures(scene: PathScene) -> dict[str, float]:
    """Return the measures of one scene; NaN where it did not come to the end of its path."""
    rig, pilot, trace = played(scene)
    if pilot.path.pending:
        return {"mean_error_N": nan, "worst_press_share": nan, "missed_mm": nan, "aside_mm": nan}
    t, push = np.array(trace.t_s), np.array(trace.push_N)
    across_m = np.array([T.translation[1] for T in trace.T_base_tcp]) - rig.arm.plate.point_m[1]
    return {
        "mean_error_N": float(np.abs(push[t >= COUNTED_FROM_S] - HOLD_N).mean()),
        "worst_press_share": float(means(t, push).max()) / HOLD_N,
        "missed_mm": 1e3 * pilot.path.missed_m,
        "aside_mm": 1e3 * float(np.abs(across_m[t >= COUNTED_FROM_S] - OFF_M[1]).max()),
    }


def programmed(rig: ForceRig, surface: str) -> Iterator[pin.SE3]:
    """Yield the poses of the program: out over the surface, and back, tool along the normal."""
    T_tool = rig.arm.T_base_tcp
    R_plate = pin.utils.rotate("x", np.radians(rig.arm.settings.tilt_deg))
    top_m = rig.arm.plate.point_m
    off = pin.SE3(pin.exp3(np.array([0.0, OFF_RAD, 0.0])), np.array(OFF_M))
    out = np.linspace(0.0, LENGTH_M, POSES)
    for s_m in (*out, *out[-2::-1]):
        angle = 0.0 if surface == "plane" else s_m / RADIUS_M
        up = R_plate @ np.array([np.sin(angle), 0.0, np.cos(angle)])
        if surface == "plane":
            place_m = top_m + R_plate @ np.array([s_m, 0.0, 0.0])
        else:
            place_m = top_m + RADIUS_M * (up - R_plate[:, 2])
        turn = pin.Quaternion.FromTwoVectors(T_tool.rotation[:, 2], -up).toRotationMatrix()
        T = pin.SE3(turn @ T_tool.rotation, place_m - top_m)
        yield pin.SE3(np.eye(3), top_m) * off * T


def _world(scene: PathScene) -> SceneSettings:
    surface: tuple[tuple[str, object], ...] = (
        ("sim.surface", scene.surface),
        ("sim.radius_m", RADIUS_M),
        ("sim.disc_radius_m", DISC_RADIUS_M),
    )
    tilt_deg = TILT_DEG if scene.surface == "plane" else 0.0
    return replace(scene.world, tilt_deg=tilt_deg, overrides=surface)


def _law(scene: PathScene, rig: ForceRig) -> LawRunner | Admittance | Fdcc:
    if scene.law in {"adaptive", "plain, known k"}:
        pilot = (adaptive if scene.law == "adaptive" else tuned_plain)(rig)
        pilot.presses_only = True
        return pilot
    cell, world = rig.cell, scene.world
    known = 0.45 / (world.stiffness_N_m * true_tau_s(world))
    inertia = 0.5 / (cell.contact.inertia_kg * cell.robot.bandwidth_rad_s)
    peer = Admittance if scene.law.startswith("admittance") else Fdcc
    return peer(
        rig.T_base_tcp, min(known, inertia), PEER_TIME_S, longest_m_s=cell.force.speed_max_m_s
    )


def path_rows(pool: Executor, *, quick: bool) -> list[Row]:
    """Return our law on every path, and the others where the loop is fast.

    `quick`: one stiffness, speed and loop.
    """
    places = [PROMISED] if quick else [*product(SPEEDS_M_S, STIFFNESSES_N_M, LOOPS_HZ)]
    jobs = [
        PathScene(law, surface, speed, SceneSettings(k, 10, hz))
        for law, (speed, k, hz), surface in product(LAWS, places, SURFACES)
        if law == "adaptive" or hz == LOOPS_HZ[0]
    ]
    return list(pool.map(path_row, jobs))


def path_row(scene: PathScene) -> Row:
    """Return one row of the table."""
    row: Row = {
        "law": scene.law,
        "surface": scene.surface,
        "speed_m_s": scene.speed_m_s,
        "stiffness_N_m": scene.world.stiffness_N_m,
        "delay_ms": scene.world.delay_ms,
        "loop_hz": scene.world.loop_hz,
    }
    measures = path_measures(scene)
    return row | {name: None if np.isnan(value) else value for name, value in measures.items()}

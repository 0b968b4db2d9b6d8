"""Path with force: 10 N along poses on a tilted plane, a cylinder and a hemisphere.

The program is off, as one taught by hand or taken from CAD is: shifted, and turned about the place
where it starts. Every law runs the product's own path (control/path_follower.py), which
differs only in that a law with a predictor foresees the height by itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from bench.force.laws import (
    ADAPTIVE,
    HOLD_N,
    LOOPS_HZ,
    AnyLaw,
    LawRunner,
    law_input,
    law_of,
    ours,
    places_of,
)
from bench.force.requirements import requirement
from bench.force.rig import ForceRig, LawSample, SceneSettings
from bench.harness import CaseTable, Options, Tables, grouped, worst
from bench.results import Row
from common.motion.convert import vec3
from control.axis_task import mode_task
from control.gain_rule import tune
from control.law import LawMotion, back_calculate, start_at
from control.path_curve import PathCurve
from control.path_follower import PathFollower
from services.regulator.path_request import turn_limits

SURFACES = ("plane", "cylinder", "hemisphere")
SPEEDS_MM_S, STIFFNESSES_N_M = (5.0, 20.0, 50.0), (5e3, 2e4, 1e5)
TILT_DEG, RADIUS_M = 8.0, 0.08
ROUND = {"sim.radius_m": RADIUS_M, "sim.disc_radius_m": 0.01}
LENGTH_M, POSES = 0.04, 25  # out, and back again
OFF_M, OFF_RAD = (0.001, 0.001, 0.001), np.radians(2.0)  # of the program, at its start and about y
ACCEL_M_S2 = 0.3
PROMISED: Row = {"law": ADAPTIVE, "speed_mm_s": 20.0, "stiffness_N_m": 2e4, "loop_hz": 250.0}
MEAN_N, WORST_SHARE = 0.3, 2.0  # promised there
REACHED_S, LONGEST_S, COUNTED_FROM_S = 2.0, 25.0, 1.0
MOST_M_S = 0.15  # of force control and path together
NO_GAINS = tune(SceneSettings().cell()).gains  # the path uses none
PRESS_ONLY = (False, False, True, False, False, False)
MEASURES = ("mean_error_N", "worst_press_share", "missed_mm", "aside_mm")


class OnPath:
    """A law whose tool also moves along a path; without a path it only presses."""

    def __init__(self, law: AnyLaw, rig: ForceRig) -> None:
        self.law, self._motion = law, start_at(rig.T_base_tcp)
        curve = PathCurve(rig.T_base_tcp, 0.0, ACCEL_M_S2, turn_limits(rig.cell))
        predicts = isinstance(law, LawRunner) and law.predicts
        self.path = PathFollower(curve, in_contact=True, predicts=predicts)
        self._task = mode_task("position", HOLD_N, axes=PRESS_ONLY)
        law.setpoint_N = HOLD_N
        if isinstance(law, LawRunner):
            law.presses_only = True

    def begin(self, poses: Sequence[pin.SE3], speed_m_s: float) -> None:
        """Begin a path that leads to its first pose and on."""
        T_start = self.path.start(self._motion.T_base_tcp, poses[0], self._task)
        curve = replace(self.path.curve, T_joined=T_start, feed_m_s=speed_m_s)
        self.path = replace(self.path, curve=curve.extended(poses, 0.0))

    def step(self, sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        if sample.limited:
            self._motion = back_calculate(self._motion, sample.T_let_through)
        motion = self._pressed(sample)
        if self.path.pending:
            given = law_input(sample, self._task, NO_GAINS, self._motion)
            most_m = MOST_M_S * sample.dt_s
            self.path, motion.T_base_tcp, _ = self.path.follow(given, motion, most_m)
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


def path_row(case: Row) -> Row:
    """Return the worst of the surfaces."""
    found = [measures(case, surface) for surface in SURFACES]
    return case | {name: worst(each.get(name) for each in found) for name in MEASURES}


def measures(case: Row, surface: str) -> Row:
    """Return the measures on one surface; none where the end of the path was not reached."""
    world = SceneSettings(
        case["stiffness_N_m"],
        10,
        case["loop_hz"],
        tilt_deg=TILT_DEG if surface == "plane" else 0.0,
        overrides={"sim.surface": surface, **ROUND},
    )
    rig = ForceRig(world.cell())
    rig.press(3.0)
    pilot = OnPath(law_of(case["law"], rig), rig)
    rig.run(pilot, REACHED_S if case["law"] == ADAPTIVE else 2.0 * REACHED_S)
    pilot.begin([*programmed(rig, surface)], case["speed_mm_s"] / 1e3)
    trace = rig.run(pilot, 0.1)
    while pilot.path.pending and trace.t_s[-1] < LONGEST_S:
        rig.run(pilot, 0.1, trace)
    if pilot.path.pending:
        return {}
    counted = np.array(trace.t_s) >= COUNTED_FROM_S
    across_m = np.array([T.translation[1] for T in trace.T_base_tcp]) - rig.arm.plate.point_m[1]
    return {
        "mean_error_N": float(np.abs(trace.after(COUNTED_FROM_S) - HOLD_N).mean()),
        "worst_press_share": float(trace.smooth_N.max()) / HOLD_N,
        "missed_mm": 1e3 * pilot.path.missed_m,
        "aside_mm": 1e3 * float(np.abs(across_m[counted] - OFF_M[1]).max()),
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


ROWS = CaseTable(
    places_of(speed_mm_s=SPEEDS_MM_S, stiffness_N_m=STIFFNESSES_N_M, loop_hz=LOOPS_HZ),
    path_row,
)
SHOWN = {"error_at_{:g}_N/m_N": "mean_error_N", "worst_press_at_{:g}_N/m": "worst_press_share"}


def measure(options: Options) -> Tables:
    """Return our law at every place, the others where the loop is fast, and what is promised."""
    promised = path_row(PROMISED)
    limits = (("mean error, N", MEAN_N, "mean_error_N"),
              ("worst press / set point", WORST_SHARE, "worst_press_share"))  # fmt: skip
    required = [requirement(text, limit, promised[name]) for text, limit, name in limits]
    rows = ROWS.measured(options)
    return {
        "requirements": required,
        "adaptive": by_loop(rows),
        "rows": rows,
    }


def by_loop(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield mean error [N] and worst press of our law, a row for each loop and speed."""
    by_rate = sorted(ours(rows), key=lambda row: -float(row["loop_hz"]))
    for place, these in grouped(by_rate, "loop_hz", "speed_mm_s"):
        yield place | {
            shown.format(row["stiffness_N_m"]): row[name]
            for row in these
            for shown, name in SHOWN.items()
        }

"""Combinations of frame, control of each axis, law and loop host, and one run of each.

The tool is held in a bushing whose stiffness is diagonal in none of the frames
(`coupled_contact.py`), so that each axis feels the motion along all others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import combinations
from math import degrees
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.force_task import AXIS_NAMES, parse_task
from forcemesh.messages import Host, PoseRecord, RegulatorTarget
from forcemesh.requests import ForceStartRequest, ForceTask, Reply
from services.regulator.admittance import AdmittanceSettings
from services.regulator.law import LawSettings
from tests.fakes.axes_checked import axes_are_checked
from tests.fakes.bench import DEMO
from tests.fakes.coupled_contact import CoupledContact, skewed_stiffness
from tests.fakes.lab import Lab

ALONG = ("held", "force:0", "force:5", "force:-4", "admittance,stiffness=1000", "free")
ABOUT = ("held", "torque:0", "torque:0.15", "torque:-0.1", "admittance,stiffness=5", "free")
FACTORS: tuple[tuple[str, ...], ...] = (
    ("mujoco", "tcp", "controller"),
    ("plain", "adaptive"),
    ("base", "tool", "sensor", "pose", "path"),
    *(ALONG,) * 3,
    *(ABOUT,) * 3,
)
K_N_M, K_NM_RAD = (1.8e4, 1.3e4, 9e3), (12.0, 9.0, 7.0)  # below those of the cell files
CELLS = {"mujoco": "demo.yaml", "tcp": "demo-tcp.yaml", "controller": "demo-tcp.yaml"}
SETTLED_MEANS = 3  # means in a row within the limits
STEP_S, MEAN_S, LONGEST_S, CHANGED_S = 0.05, 0.5, 25.0, 1.0
NOISE_N, NOISE_NM = 0.15, 0.02  # of a mean over MEAN_S, with the rounding of packets
CROSS_M, CROSS_RAD = 2e-4, np.radians(0.2)
BUMP_N, LEVER_M = 1.0, 0.1  # a torque counts as a force at this lever

Values = tuple[str, ...]  # one for each factor
Pair = tuple[int, str, int, str]  # of two factors, by number and value


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one run: the reply to its start, and its largest errors over their limits."""

    reply: Reply
    steady: float = 0.0  # error of a controlled axis
    cross: float = 0.0  # motion of a held axis
    bump: float = 0.0  # change of force by a change of frame and axes that asks for no change
    text: str = ""


def covering_array(factors: Sequence[Sequence[str]], seed: int = 0) -> list[Values]:
    """Return rows in which each pair of values of two factors occurs (greedy, pairwise)."""
    rng = np.random.default_rng(seed)
    open_pairs = {
        (i, a, j, b)
        for i, j in combinations(range(len(factors)), 2)
        for a in factors[i]
        for b in factors[j]
    }
    rows: list[Values] = []
    while open_pairs:
        tries = []
        for _ in range(30):
            row: list[str] = [""] * len(factors)
            i, a, j, b = sorted(open_pairs)[rng.integers(len(open_pairs))]
            row[i], row[j] = a, b
            for k in rng.permutation(len(factors)):
                if not row[k]:
                    values = rng.permutation(np.array(factors[k])).tolist()
                    row[k] = max(values, key=partial(_covers, row, k, open_pairs))
            tries.append(tuple(row))
        best = max(tries, key=lambda row: len(open_pairs & pairs_of(row)))
        rows.append(best)
        open_pairs -= pairs_of(best)
    return rows


def pairs_of(row: Sequence[str]) -> set[Pair]:
    """Return the pairs of values that occur in a row."""
    return {(i, row[i], j, row[j]) for i, j in combinations(range(len(row)), 2)}


def _covers(row: list[str], k: int, open_pairs: set[Pair], value: str) -> int:
    """Return how many open pairs a value of factor k would close with the values in the row."""
    pairs = ((i, row[i], k, value) if i < k else (k, value, i, row[i]) for i in range(len(row)))
    return sum(1 for pair in pairs if pair in open_pairs)


def drawn(count: int, seed: int) -> Iterator[Values]:
    """Yield drawn combinations that the loop host can run."""
    rng = np.random.default_rng(seed)
    while count:
        row = tuple(str(rng.choice(factor)) for factor in FACTORS)
        if row[0] == "controller":  # its commands hold base axes, and nothing but set points
            kinds = [kind.replace("free", "held") for kind in row[3:]]
            row = (*row[:2], "base", *("held" if "," in kind else kind for kind in kinds))
        if row[2] == "path":
            row = (*row[:3], "held", *row[4:])
        if not all(kind == "held" for kind in row[3:]):
            count -= 1
            yield row


@cache
def cell_of(place: str, law: str) -> CellConfig:
    """Return the cell of a loop host with a law, far above its plate."""
    path = DEMO.parent / CELLS[place]
    rates = {} if place != "mujoco" else {"rates.control_hz": 125, "rates.robot_hz": 125}
    return load_cell(path, {"sim.gap_m": 0.08, "force.law": law, "sim.seed": 3} | rates)


def task_of(row: Values, T_base_tcp: pin.SE3) -> ForceTask:
    """Return the task of a combination."""
    frame, pose = row[2], None
    if frame == "pose":
        R = pin.utils.rotate("z", 0.7) @ pin.utils.rotate("x", 0.4)
        x, y, z, w = pin.Quaternion(R).coeffs().tolist()
        p_m = tuple((T_base_tcp.translation + np.array([0.004, -0.003, 0.006])).tolist())
        pose = PoseRecord(position_m=p_m, orientation_xyzw=(x, y, z, w))
    text = " ".join(f"{name}={kind}" for name, kind in zip(AXIS_NAMES, row[3:], strict=True))
    return parse_task(text, frame, pose)  # type: ignore[arg-type]


class AxesRig:
    """A virtual cell with its tool in the bushing, and the errors of a task."""

    def __init__(self, row: Values, seed: int) -> None:
        """Put the bushing on, tare and arm."""
        self.place, law = row[:2]
        self.cell = cell_of(self.place, law)
        self.lab = Lab(self.cell)
        rng = np.random.default_rng(seed)
        arm = self.lab.cell.arm
        bushing: Any = CoupledContact(arm, skewed_stiffness(rng, K_N_M, K_NM_RAD))
        arm.plate = bushing
        axes_are_checked(self.lab.cell.client)
        if seed % 2:  # the tool is already loaded along and about all axes
            bushing.shift(rng.uniform(-3e-4, 3e-4, 3), rng.uniform(-0.01, 0.01, 3))
            self.lab.cell.advance(0.2)
        self.target = self.lab.cell.client.reader(topics.REGULATOR_TARGET)
        self.T_start = arm.T_base_tcp

    def start(self, task: ForceTask) -> Reply:
        """Request a task on the loop host of the combination."""
        host: Host = "controller" if self.place == "controller" else "pc"
        reply: Reply = self.lab.ask(topics.FORCE_START, ForceStartRequest(task=task, host=host))
        self.T_start = self.lab.cell.arm.T_base_tcp
        return reply

    def means(self, duration_s: float) -> tuple[Array, Array]:
        """Return means of the exerted loads and of the deviations along and about the axes."""
        loads, deviations = [], []
        for _ in range(round(duration_s / STEP_S)):
            self.lab.cell.advance(STEP_S)
            target: RegulatorTarget = self.lab.now(self.target)
            assert target.valid, (target.code, target.reason, self.lab.status)
            loads.append([axis.exerted for axis in target.axes])
            deviations.append([axis.deviation for axis in target.axes])
        return np.mean(loads, axis=0), np.mean(deviations, axis=0)

    def steady(self, task: ForceTask) -> float:
        """Return the largest error over its limit after settling, of all controlled axes."""
        law, guiding = LawSettings.of(self.cell), AdmittanceSettings.of(self.cell).plain
        quiet_N = max(law.deadband_N, law.rest_N) + NOISE_N
        quiet_Nm = law.deadband_Nm + NOISE_NM
        worst, began_s, settled = np.inf, 0.0, 0
        while settled < SETTLED_MEANS and began_s < LONGEST_S:
            loads, deviations = self.means(MEAN_S)
            began_s += MEAN_S
            errors = []
            for number, axis in enumerate(task.axes):
                turns, load, away = number >= 3, loads[number], deviations[number]
                loose = guiding.deadband_Nm + NOISE_NM if turns else guiding.deadband_N + NOISE_N
                if axis.control == "force":
                    errors.append(abs(load - axis.setpoint) / (quiet_Nm if turns else quiet_N))
                elif axis.control != "held":
                    errors.append(abs(load + axis.stiffness * away) / loose)
            worst = max(errors, default=0.0)
            settled = settled + 1 if worst <= 1.0 else 0
        return float(worst)

    def cross(self, task: ForceTask, R_task: Array) -> float:
        """Return the largest motion of a held axis since the start, over its limit."""
        T = self.lab.cell.arm.T_base_tcp
        moved = R_task.T @ (T.translation - self.T_start.translation)
        turned = R_task.T @ pin.log3(T.rotation @ self.T_start.rotation.T)
        shares = [*(abs(moved) / CROSS_M), *(abs(turned) / CROSS_RAD)]
        held = (axis.control == "held" for axis in task.axes)
        return float(max((s for s, flag in zip(shares, held, strict=True) if flag), default=0.0))

    def bump(self, task: ForceTask) -> float:
        """Return the largest change of a controlled load after the start of a task, in newtons."""
        largest_N = 0.0
        for _ in range(round(CHANGED_S / STEP_S)):
            loads, _ = self.means(STEP_S)
            for number, axis in enumerate(task.axes):
                lever = LEVER_M if number >= 3 else 1.0
                if axis.control == "force":
                    largest_N = max(largest_N, abs(loads[number] - axis.setpoint) / lever)
        return largest_N


def frame_axes(task: ForceTask, T_base_tcp: pin.SE3, cell: CellConfig) -> Array:
    """Return the axes of a task frame in base, computed without the regulator. Shape (3, 3)."""
    if task.frame in ("tool", "path"):
        return np.array(T_base_tcp.rotation)
    if task.frame == "sensor":
        T_base_flange = T_base_tcp * cell.tool.T_flange_tcp.pose.inverse()
        return np.array((T_base_flange * cell.sensor.T_flange_sensor.pose).rotation)
    if task.pose is not None:
        return np.array(pin.Quaternion(*np.roll(task.pose.orientation_xyzw, 1)).matrix())
    return np.eye(3)


def run(row: Values, seed: int) -> Outcome:
    """Run one combination: settle, then change to another frame without a change of loads."""
    rig = AxesRig(row, seed)
    task = task_of(row, rig.T_start)
    reply = rig.start(task)
    if not reply.accepted:
        return Outcome(reply)
    assert f"law {row[1]}" in reply.text, reply.text  # not another in its place
    R_task = frame_axes(task, rig.T_start, rig.cell)
    steady = rig.steady(task)
    cross = rig.cross(task, R_task)
    text = ", ".join(
        f"{name} {axis.exerted:.3g} ({1e3 * axis.deviation:.3f} mm, {degrees(axis.deviation):.3f})"
        for name, axis in zip(AXIS_NAMES, rig.lab.now(rig.target).axes, strict=True)
    )
    bump = rig.bump(rig_same(rig, task, row))
    return Outcome(reply, steady, cross, bump / BUMP_N, text)


def rig_same(rig: AxesRig, task: ForceTask, row: Values) -> ForceTask:
    """Start a task in another frame whose set points are the present loads; return it."""
    wrench = rig.lab.now(rig.lab.wrench)
    frame = "base" if row[2] == "tool" or row[0] == "controller" else "tool"
    R = np.eye(3) if frame == "base" else rig.lab.cell.arm.T_base_tcp.rotation
    loads = [*(-R.T @ np.array(wrench.force_N)), *(-R.T @ np.array(wrench.torque_Nm))]
    moves = any(axis.control == "force" for axis in task.axes[:3])
    turns = any(axis.control == "force" for axis in task.axes[3:])
    kinds = [f"force:{load:.6f}" if moves else "held" for load in loads[:3]]
    kinds += [f"torque:{load:.6f}" if turns else "held" for load in loads[3:]]
    text = " ".join(f"{name}={kind}" for name, kind in zip(AXIS_NAMES, kinds, strict=True))
    same = parse_task(text, frame)  # type: ignore[arg-type]
    reply = rig.start(same)
    assert reply.accepted, reply
    return same

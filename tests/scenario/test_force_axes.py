"""Force control of each axis in any frame, on a contact that couples all of them."""

from collections.abc import Iterator
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import Array
from control.compliance import ComplianceSettings
from control.law import LawSettings
from forcemesh import topics
from forcemesh.force_task import AXIS_NAMES, parse_task
from forcemesh.messages import PoseRecord
from forcemesh.requests import ForceStartRequest, ForceTask
from tests.fakes.bench import DEMO
from tests.fakes.coupled_contact import CoupledContact, skewed_stiffness
from tests.fakes.lab import Lab

ALONG = ("held", "force:0", "force:5", "force:-4", "compliant,stiffness=1000", "compliant")
ABOUT = ("held", "torque:0", "torque:0.15", "torque:-0.1", "compliant,stiffness=5", "compliant")
FACTORS: tuple[tuple[str, ...], ...] = (
    ("mujoco", "tcp", "controller"),
    ("plain", "adaptive"),
    ("base", "tool", "sensor", "pose", "path"),
    *(ALONG,) * 3,
    *(ABOUT,) * 3,
)
K_N_M, K_NM_RAD = (1.8e4, 1.3e4, 9e3), (12.0, 9.0, 7.0)  # below those of the cell files
SETTLED_MEANS = 3  # means in a row within the limits
STEP_S, MEAN_S, LONGEST_S, CHANGED_S = 0.05, 0.5, 25.0, 1.0
NOISE_N, NOISE_NM = 0.15, 0.02  # of a mean over MEAN_S, with the rounding of packets
CROSS_M, CROSS_RAD = 2e-4, np.radians(0.2)
BUMP_N, LEVER_M = 1.0, 0.1  # a torque counts as a force at this lever

BATCHES, PER_BATCH = 50, 20  # of the nightly run

Values = tuple[str, ...]  # one for each factor


def drawn(count: int, seed: int) -> Iterator[Values]:
    """Yield drawn combinations that the loop host can run."""
    rng = np.random.default_rng(seed)
    while count:
        row = tuple(str(rng.choice(factor)) for factor in FACTORS)
        if row[0] == "controller":  # its commands hold base axes, and nothing but set points
            kinds = ("held" if kind.startswith("compliant") else kind for kind in row[3:])
            row = (*row[:2], "base", *kinds)
        if row[2] == "path":
            row = (*row[:3], "held", *row[4:])
        if not all(kind == "held" for kind in row[3:]):
            count -= 1
            yield row


@cache
def cell_of(place: str, law: str) -> CellConfig:
    """Return the cell of a loop host with a law, far above its plate."""
    path = DEMO if place == "mujoco" else DEMO.with_name("demo-tcp.yaml")
    rates = {} if place != "mujoco" else {"rates.control_hz": 125, "rates.robot_hz": 125}
    return load_cell(path, {"sim.gap_m": 0.08, "force.law": law, "sim.seed": 3} | rates)


def task_of(kinds: tuple[str, ...], frame: str, T_base_tcp: pin.SE3) -> ForceTask:
    """Return the task of a frame and six kinds of control."""
    pose = None
    if frame == "pose":
        R = pin.utils.rotate("z", 0.7) @ pin.utils.rotate("x", 0.4)
        x, y, z, w = pin.Quaternion(R).coeffs().tolist()
        p_m = tuple((T_base_tcp.translation + np.array([0.004, -0.003, 0.006])).tolist())
        pose = PoseRecord(position_m=p_m, orientation_xyzw=(x, y, z, w))
    text = " ".join(f"{name}={kind}" for name, kind in zip(AXIS_NAMES, kinds, strict=True))
    return parse_task(text, frame, pose)  # type: ignore[arg-type]


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


class AxesRig:
    """A virtual cell with its tool in the bushing, and the errors of a task over their limits."""

    def __init__(self, row: Values, seed: int) -> None:
        """Put the bushing on and start the task of a combination."""
        self.row, self.cell = row, cell_of(*row[:2])
        self.lab = Lab(self.cell)
        arm = self.lab.cell.arm
        rng = np.random.default_rng(seed)
        bushing: Any = CoupledContact(arm, skewed_stiffness(rng, K_N_M, K_NM_RAD))
        arm.plate = bushing
        if seed % 2:  # the tool is already loaded along and about all axes
            bushing.shift(rng.uniform(-3e-4, 3e-4, 3), rng.uniform(-0.01, 0.01, 3))
        self.lab.cell.advance(0.2)
        self.target = self.lab.cell.client.reader(topics.REGULATOR_TARGET)
        self.start(task_of(row[3:], row[2], arm.T_base_tcp))

    def start(self, task: ForceTask) -> None:
        """Start a task on the loop host of the combination, with its law."""
        self.task, self.T_start = task, self.lab.cell.arm.T_base_tcp
        host: Any = "controller" if self.row[0] == "controller" else "pc"
        reply = self.lab.ask(topics.FORCE_START, ForceStartRequest(task=task, host=host))
        assert reply.accepted, (self.row, reply)
        assert f"law {self.row[1]}" in reply.text, reply.text  # not another in its place

    def means(self, duration_s: float) -> tuple[Array, Array]:
        """Return means of the exerted loads and of the deviations along and about the axes."""
        loads, deviations = [], []
        for _ in range(round(duration_s / STEP_S)):
            self.lab.cell.advance(STEP_S)
            target = self.lab.now(self.target)
            assert target.valid, (self.row, target.code, target.reason, self.lab.status)
            loads.append([axis.exerted for axis in target.axes])
            deviations.append([axis.deviation for axis in target.axes])
        return np.mean(loads, axis=0), np.mean(deviations, axis=0)

    def steady(self) -> float:
        """Return the largest error after settling, of all controlled and compliant axes."""
        law, guiding = LawSettings.of(self.cell), ComplianceSettings.of(self.cell)
        quiet = [max(law.deadband_N, law.rest_N) + NOISE_N] * 3 + [law.deadband_Nm + NOISE_NM] * 3
        loose = [guiding.deadband_N + NOISE_N] * 3 + [guiding.deadband_Nm + NOISE_NM] * 3
        worst, settled = np.inf, 0
        for _ in range(round(LONGEST_S / MEAN_S)):
            rows = zip(self.task.axes, *self.means(MEAN_S), quiet, loose, strict=True)
            errors = [
                abs(load - axis.setpoint) / near
                if axis.control == "force"
                else abs(load + axis.stiffness * away) / far
                for axis, load, away, near, far in rows
                if axis.control != "held"
            ]
            worst = float(max(errors))
            settled = settled + 1 if worst <= 1.0 else 0
            if settled == SETTLED_MEANS:
                break
        return worst

    def cross(self) -> float:
        """Return the largest motion of a held axis since the start."""
        T, R_task = self.lab.cell.arm.T_base_tcp, frame_axes(self.task, self.T_start, self.cell)
        moved = R_task.T @ (T.translation - self.T_start.translation) / CROSS_M
        turned = R_task.T @ pin.log3(T.rotation @ self.T_start.rotation.T) / CROSS_RAD
        held = [axis.control == "held" for axis in self.task.axes]
        return float(np.abs(np.array([*moved, *turned])[held]).max(initial=0.0))

    def bump(self) -> float:
        """Change to another frame with the mean loads; return the largest change of a load.

        A compliant axis moves within its deadband: one sample is off the mean by up to that.
        """
        loads, R_task = self.means(MEAN_S)[0], frame_axes(self.task, self.T_start, self.cell)
        frame = "base" if self.row[2] == "tool" or self.row[0] == "controller" else "tool"
        T = self.lab.cell.arm.T_base_tcp
        R = np.eye(3) if frame == "base" else T.rotation
        moves, turns = (
            any(axis.control == "force" for axis in half)
            for half in (self.task.axes[:3], self.task.axes[3:])
        )
        forces = [f"force:{load:.6f}" for load in R.T @ R_task @ loads[:3]]
        torques = [f"torque:{load:.6f}" for load in R.T @ R_task @ loads[3:]]
        kinds = (*(forces if moves else ["held"] * 3), *(torques if turns else ["held"] * 3))
        if not (moves or turns):
            return 0.0
        self.start(task_of(kinds, frame, T))
        largest_N, levers = 0.0, [1.0] * 3 + [LEVER_M] * 3
        for _ in range(round(CHANGED_S / STEP_S)):
            rows = zip(self.task.axes, self.means(STEP_S)[0], levers, strict=True)
            changes_N = [abs(load - axis.setpoint) / lever for axis, load, lever in rows
                         if axis.control == "force"]  # fmt: skip
            largest_N = max(largest_N, *changes_N)
        return float(largest_N) / BUMP_N


def pairs_of(row: Values) -> set[tuple[int, str, int, str]]:
    """Return the pairs of values that occur in a row."""
    return {(i, row[i], j, row[j]) for i, j in combinations(range(len(row)), 2)}


def rows_with_every_pair() -> list[Values]:
    """Return rows in which each pair of values that a loop host can run occurs."""
    rows = [*drawn(1500, seed=BATCHES)]
    missing, chosen = set[tuple[int, str, int, str]]().union(*map(pairs_of, rows)), []
    while missing:
        chosen.append(max(rows, key=lambda row: len(missing & pairs_of(row))))
        missing -= pairs_of(chosen[-1])
    return chosen


ROWS = rows_with_every_pair()


def assert_promises(row: Values, seed: int) -> None:
    """Set points are reached, held axes hold, and a change of frame makes no step of force."""
    rig = AxesRig(row, seed)
    found = {"steady": rig.steady(), "cross": rig.cross(), "bump": rig.bump()}
    assert max(found.values()) <= 1.0, (row, found)


@pytest.mark.parametrize("number", range(len(ROWS)))
def test_each_pair_of_frame_axes_law_and_host(number: int) -> None:
    """What a loop host cannot run is refused: test_axis_task.py."""
    assert_promises(ROWS[number], number)


@pytest.mark.long
@pytest.mark.axes
@pytest.mark.parametrize("batch", range(BATCHES))
def test_drawn_combinations(batch: int) -> None:
    """The nightly run draws a thousand."""
    for number, row in enumerate(drawn(PER_BATCH, seed=batch)):
        assert_promises(row, number)

"""Sensor faults while the arm presses, on the virtual clock: time to the hold, and its code.

A wrong wiring is present from the start: the first contact must show it, for all 48 permutations
and signs of the three axes.
"""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from rich.table import Table

from bench.faults import FaultCell
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from sim.robot.ft_sensor import FtSample, FtStatus

Disturb = Callable[[FtSample], FtSample | None]

STIFF_N_M = 20_000.0  # the demo's plate
PRESSED_N, PRESS_S, WITHIN_S, SLIDE_S = 8.0, 1.5, 0.3, 6.0
TOUCH_N = 0.5


def frozen() -> Disturb:
    """Return a sensor that repeats the next reading forever."""
    kept: list[FtSample] = []

    def disturb(sample: FtSample) -> FtSample:
        kept.append(sample)
        return kept[0]

    return disturb


def adding(force_N: float, status: FtStatus | None = None) -> Disturb:
    """Return a sensor that adds a force to one axis, or reports a status."""

    def disturb(sample: FtSample) -> FtSample:
        bent_N = sample.force_N + np.array([0.0, force_N, 0.0])
        return FtSample(bent_N, sample.torque_Nm, status or sample.status, sample.counter)

    return disturb


FAULTS: dict[str, Callable[[], Disturb]] = {
    "not a number": lambda: adding(np.nan),
    "infinite": lambda: adding(np.inf),
    "reports saturation": lambda: adding(0.0, "saturated"),
    "beyond 95 % of its range": lambda: adding(480.0),
    "reports a fault": lambda: adding(0.0, "fault"),
    "a step larger than physics allows": lambda: adding(250.0),
    "frozen": frozen,
    "silent": lambda: lambda _: None,
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Time to the hold and its code; increase of the force, travel since the first contact."""

    held_s: float
    code: str
    more_N: float = 0.0
    travel_m: float = 0.0


class TruthObserver:
    """Observer of the true force and travel each millisecond until the arbiter holds."""

    def __init__(self, world: FaultCell) -> None:
        """Observe a cell."""
        self._world, self._arm = world.world, world.world.arm
        self._arbiter = self._world.client.reader(topics.ARBITER_STATUS)
        self._command = self._world.client.reader(topics.ROBOT_COMMAND)
        self._touched_m: Array | None = None
        self.peak_N = self.travel_m = 0.0

    def until_held(self, timeout_s: float) -> float:
        """Return the time until the permission was revoked [s]; infinite if it was not."""
        before_ns = self._world.clock.now_ns()
        self._world.advance(timeout_s, self._held)
        if not self._held():
            return float("inf")
        took_s = (self._world.clock.now_ns() - before_ns) / NS_PER_S
        self._world.advance(0.3, self._observe)
        return took_s

    def code(self) -> str:
        """Return the causes that the arbiter reports."""
        status = self._arbiter.read(self._world.clock.now_ns()).message
        return ", ".join(dict.fromkeys(trip.code for trip in status.trips)) if status else ""

    def _held(self) -> bool:
        self._observe()
        command = self._command.read(self._world.clock.now_ns()).message
        return command is not None and command.permission is None

    def _observe(self) -> bool:
        force_N = float(np.linalg.norm(self._arm.true_wrench().force_N))
        p_m = np.array(self._arm.T_base_tcp.translation)
        self.peak_N = max(self.peak_N, force_N)
        if self._touched_m is None and force_N > TOUCH_N:
            self._touched_m = p_m
        if self._touched_m is not None:
            self.travel_m = max(self.travel_m, float(np.linalg.norm(p_m - self._touched_m)))
        return False


def fault(name: str) -> Outcome:
    """Press, let the sensor fail, observe."""
    world = FaultCell("sim", gap_m=0.001, stiffness_N_m=STIFF_N_M)
    world.feedback(PRESSED_N, "pc")
    world.live(PRESS_S)
    observer = TruthObserver(world)
    before_N = float(np.linalg.norm(world.world.arm.true_wrench().force_N))
    world.world.arm.ft_sensor.disturb = FAULTS[name]()
    held_s = observer.until_held(WITHIN_S)
    return Outcome(held_s, observer.code(), more_N=observer.peak_N - before_N)


def wirings() -> list[Array]:
    """Return the 48 permutations and signs of three axes, the correct one first."""
    axes = np.eye(3)
    signs = list(product((1.0, -1.0), repeat=3))
    return [np.diag(sign) @ axes[list(order)] for order in permutations(range(3)) for sign in signs]


def wiring(number: int) -> Outcome:
    """Tare, apply one of these wirings to the force axes, and press."""
    world = FaultCell("sim", gap_m=0.001, stiffness_N_m=STIFF_N_M)
    sensor, wired = world.world.arm.ft_sensor, wirings()[number]
    rest = world.world.arm.ft_sensor.sample()

    def disturb(sample: FtSample) -> FtSample:
        force_N = rest.force_N + wired @ (sample.force_N - rest.force_N)
        return FtSample(force_N, sample.torque_Nm, sample.status, sample.counter)

    sensor.disturb = disturb
    observer = TruthObserver(world)
    world.feedback(PRESSED_N, "pc")
    held_s = observer.until_held(SLIDE_S)
    return Outcome(held_s, observer.code(), more_N=observer.peak_N, travel_m=observer.travel_m)


def table() -> Table:
    """Return time to the hold, code and increase of the press force for each fault."""
    tested = wirings()
    with ProcessPoolExecutor() as pool:
        faults = dict(zip(FAULTS, pool.map(fault, FAULTS), strict=True))
        wired = list(pool.map(wiring, range(len(tested)), chunksize=4))
    rows = Table(title=f"Sensor faults at {PRESSED_N:g} N, virtual clock", title_justify="left")
    for name in ("fault", "held after", "code", "force increase", "travel after contact"):
        rows.add_column(name)
    for name, outcome in faults.items():
        rows.add_row(
            name, f"{outcome.held_s * 1e3:.0f} ms", outcome.code, f"{outcome.more_N:.1f} N", "-"
        )
    wrong = list(zip(tested, wired, strict=True))[1:]
    axial = [outcome for matrix, outcome in wrong if matrix[2, 2] != 1.0]
    sideways = [outcome for matrix, outcome in wrong if matrix[2, 2] == 1.0]
    rows.add_row(*wired_row("wirings in which the press is not visible", axial))
    rows.add_row(*wired_row("wirings that are wrong laterally only", sideways))
    return rows


def wired_row(name: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    """Return the row of a group of wirings: number stopped, and the worst values."""
    stopped = [each for each in outcomes if np.isfinite(each.held_s)]
    return (
        f"{len(stopped)} of {len(outcomes)} {name}",
        f"{max(each.held_s for each in stopped) * 1e3:.0f} ms" if stopped else "-",
        ", ".join(sorted({each.code for each in stopped})),
        f"{max(each.more_N for each in outcomes):.1f} N",
        f"{max(each.travel_m for each in outcomes) * 1e3:.2f} mm",
    )

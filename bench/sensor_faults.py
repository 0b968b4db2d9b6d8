"""Sensor faults while the arm presses, on the virtual clock: time to the hold, and its code.

A wrong wiring is present from the start: the first contact must show it, for all 48 permutations
and signs of the three axes.
"""

from collections.abc import Callable, Sequence
from math import inf, isfinite

import numpy as np

from bench.faults import FaultCell
from bench.harness import CaseTable, Options
from bench.results import Row, Table, table
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from identification.installation.axis_fit import SIGNED
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
            return inf
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


def fault(name: str) -> Row:
    """Press, let the sensor fail, observe."""
    world = FaultCell("sim", gap_m=0.001, stiffness_N_m=STIFF_N_M)
    world.feedback(PRESSED_N, "pc")
    world.live(PRESS_S)
    observer = TruthObserver(world)
    before_N = float(np.linalg.norm(world.world.arm.true_wrench().force_N))
    world.world.arm.ft_sensor.disturb = FAULTS[name]()
    held_s = observer.until_held(WITHIN_S)
    return {
        "fault": name,
        "held_after_ms": 1e3 * held_s,
        "code": observer.code(),
        "force_increase_N": observer.peak_N - before_N,
    }


def wiring(number: int) -> Row:
    """Tare, apply one of these wirings to the force axes, and press."""
    world = FaultCell("sim", gap_m=0.001, stiffness_N_m=STIFF_N_M)
    sensor, wired = world.world.arm.ft_sensor, SIGNED[number]
    rest = world.world.arm.ft_sensor.sample()

    def disturb(sample: FtSample) -> FtSample:
        force_N = rest.force_N + wired @ (sample.force_N - rest.force_N)
        return FtSample(force_N, sample.torque_Nm, sample.status, sample.counter)

    sensor.disturb = disturb
    observer = TruthObserver(world)
    world.feedback(PRESSED_N, "pc")
    held_s = observer.until_held(SLIDE_S)
    return {
        "wiring": name_of(wired),
        "press_is_visible": bool(wired[2, 2] == 1.0),
        "held_after_ms": 1e3 * held_s,
        "code": observer.code(),
        "force_N": observer.peak_N,
        "travel_mm": 1e3 * observer.travel_m,
    }


def name_of(wiring: Array) -> str:
    """Return the true axes that the three channels show."""
    return " ".join(
        f"{'-' if each.min() < 0.0 else '+'}{'xyz'[int(np.argmax(abs(each)))]}" for each in wiring
    )


FAULT_ROWS = CaseTable(
    {"fault": "", "held_after_ms": ".0f", "code": "", "force_increase_N": ".1f"}, [*FAULTS], fault
)
HELD = {"held_after_ms": ".0f", "code": "", "force_N": ".1f", "travel_mm": ".2f"}
WIRING_ROWS = CaseTable({"wiring": "", "press_is_visible": "", **HELD}, range(len(SIGNED)), wiring)


def measure(options: Options) -> dict[str, Table]:
    """Return time to the hold, code and force for each fault and each wiring, and the worst."""
    faults, wired = FAULT_ROWS.measured(options), WIRING_ROWS.measured(options)
    groups = {
        "the press is not visible": [each for each in wired if not each["press_is_visible"]],
        "wrong laterally only": [each for each in wired[1:] if each["press_is_visible"]],
    }
    worst = [{"wirings": name, **_worst(group)} for name, group in groups.items()]
    return {
        "faults": FAULT_ROWS.stored(faults),
        "wirings": WIRING_ROWS.stored(wired),
        "worst-wirings": table({"wirings": "", "stopped": "d", "of": "d", **HELD}, worst),
    }


def _worst(group: Sequence[Row]) -> Row:
    """Return how many wirings were stopped, and the worst values."""
    stopped = [each for each in group if isfinite(each["held_after_ms"])]
    return {
        "stopped": len(stopped),
        "of": len(group),
        "held_after_ms": max((each["held_after_ms"] for each in stopped), default=None),
        "code": ", ".join(sorted({each["code"] for each in stopped})),
        "force_N": max((each["force_N"] for each in group), default=None),
        "travel_mm": max((each["travel_mm"] for each in group), default=None),
    }

"""Sensor faults while the arm presses, on the virtual clock: time to the hold, and its code.

A wrong wiring is present from the start: the first contact must show it, for all 48 permutations
and signs of the three axes.
"""

from collections.abc import Callable, Sequence
from math import inf, isfinite

import numpy as np

from bench.faults import armed_cell, cell_for
from bench.harness import CaseTable, Options, Tables, largest
from bench.results import Row
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from identification.installation.axis_fit import SIGNED
from launch.virtual_cell import VirtualCell
from sim.robot.ft_sensor import FtSample, FtStatus

Disturb = Callable[[FtSample], FtSample | None]

STIFF_N_M = 20_000.0  # the demo's plate
PRESSED_N, PRESS_S, WITHIN_S, SLIDE_S = 8.0, 1.5, 0.3, 6.0
TOUCH_N, SETTLED_S = 0.5, 0.1
GAP_M = 0.001


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


def until_held(world: VirtualCell, timeout_s: float) -> Row:
    """Let time pass until the permission is revoked, and a while more; return what happened.

    The time is infinite if it was not revoked; force and travel after the touch are true ones.
    """
    arbiter = world.client.reader(topics.ARBITER_STATUS)
    command = world.client.reader(topics.ROBOT_COMMAND)
    forces_N, places_m = list[float](), list[Array]()

    def observe() -> bool:
        forces_N.append(true_force_N(world))
        places_m.append(np.array(world.arm.T_base_tcp.translation))
        return False

    def is_held() -> bool:
        observe()
        message = command.read(world.clock.now_ns()).message
        return message is not None and message.permission is None

    before_ns = world.clock.now_ns()
    world.advance(timeout_s, is_held)
    held_s = (world.clock.now_ns() - before_ns) / NS_PER_S if is_held() else inf
    if isfinite(held_s):
        world.advance(0.3, observe)
    status = arbiter.read(world.clock.now_ns()).message
    first = next((n for n, force_N in enumerate(forces_N) if force_N > TOUCH_N), -1)
    touched = np.array(places_m[first:])
    return {
        "held_s": held_s,
        "code": ", ".join(dict.fromkeys(trip.code for trip in status.trips)) if status else "",
        "peak_N": max(forces_N),
        "travel_mm": 1e3 * float(np.linalg.norm(touched - touched[0], axis=1).max()),
    }


def true_force_N(world: VirtualCell) -> float:
    """Return the size of the force on the tool [N]."""
    return float(np.linalg.norm(world.arm.true_wrench().force_N))


def fault(name: str) -> Row:
    """Press, let the sensor fail, observe."""
    world, client = armed_cell(cell_for("sim", STIFF_N_M, {"sim.gap_m": GAP_M}))
    world.advance(SETTLED_S)
    client.force.start(PRESSED_N)
    world.advance(PRESS_S)
    before_N = true_force_N(world)
    world.arm.ft_sensor.disturb = FAULTS[name]()
    found = until_held(world, WITHIN_S)
    return {
        "fault": name,
        "held_after_ms": 1e3 * found["held_s"],
        "code": found["code"],
        "force_increase_N": found["peak_N"] - before_N,
    }


def wiring(number: int) -> Row:
    """Tare, apply one of these wirings to the force axes, and press."""
    world, client = armed_cell(cell_for("sim", STIFF_N_M, {"sim.gap_m": GAP_M}))
    world.advance(SETTLED_S)
    wired, both = SIGNED[number], np.eye(6)
    both[:3, :3] = wired
    world.arm.ft_sensor.disturb = tared_sensor(world, both)
    client.force.start(PRESSED_N)
    found = until_held(world, SLIDE_S)
    return {
        "wiring": name_of(wired),
        "press_is_visible": bool(wired[2, 2] == 1.0),
        "held_after_ms": 1e3 * found["held_s"],
        "force_N": found["peak_N"],
        **found,
    }


def tared_sensor(world: VirtualCell, wiring: Array) -> Disturb:
    """Return a sensor with the correct reading at rest whose changes pass through a wiring."""
    rest = world.arm.ft_sensor.sample()
    at_rest = np.concatenate((rest.force_N, rest.torque_Nm))

    def disturb(sample: FtSample) -> FtSample:
        grown = np.concatenate((sample.force_N, sample.torque_Nm)) - at_rest
        shown = at_rest + wiring @ grown
        return FtSample(shown[:3], shown[3:], sample.status, sample.counter)

    return disturb


def name_of(wiring: Array) -> str:
    """Return the true axes that the three channels show."""
    return " ".join(
        f"{'-' if each.min() < 0.0 else '+'}{'xyz'[int(np.argmax(abs(each)))]}" for each in wiring
    )


FAULT_ROWS = CaseTable([*FAULTS], fault)
WIRING_ROWS = CaseTable(range(len(SIGNED)), wiring)


def measure(options: Options) -> Tables:
    """Return time to the hold, code and force for each fault and each wiring, and the worst."""
    faults, wired = FAULT_ROWS.measured(options), WIRING_ROWS.measured(options)
    groups = {
        "the press is not visible": [each for each in wired if not each["press_is_visible"]],
        "wrong laterally only": [each for each in wired[1:] if each["press_is_visible"]],
    }
    worst = [{"wirings": name, **worst_of(group)} for name, group in groups.items()]
    return {"faults": faults, "wirings": wired, "worst-wirings": worst}


def worst_of(group: Sequence[Row]) -> Row:
    """Return how many wirings were stopped, and the worst values."""
    stopped = [each for each in group if isfinite(each["held_after_ms"])]
    return {
        "stopped": len(stopped),
        "of": len(group),
        "code": ", ".join(sorted({each["code"] for each in stopped})),
        **largest(stopped, ["held_after_ms"]),
        **largest(group, ["force_N", "travel_mm"]),
    }

"""Force while processes stand still, on the virtual clock.

The arm presses on the plate. It releases by a set point of zero, or is stopped and started again
with that set point; then the request falls into a stall. From shortly before the touch on, one
process or all of them stand still again and again: which one, how long and when is drawn from the
seed. A process that stands still neither reads nor publishes; then it finds the newest message of
each topic.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import hypot

from bench.harness import QUICK_STEP, Options, Tables
from bench.results import ROOT, Row
from cli.demo.cell import DemoOverrides, demo_cell
from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig, Deadlines
from common.runtime.service import Runner
from forcemesh.clock import NS_PER_S
from forcemesh.errors import RefusedError
from forcemesh.messages import OPERATIONAL
from launch.virtual_cell import VirtualCell

CELL = ROOT / "cells" / "demo.yaml"
SEEDS = 250  # of each case
SETPOINT_N = 20.0
TOUCH_SHARE = 0.5  # of the set point: from this press on the tool must not lift off
READY_S, APPROACH_S, PRESS_S, RELEASE_S, HELD_S = 1.8, 5.0, 1.5, 1.0, 0.5
NEAR_M = 0.002  # from the plate the stalls begin
OBSERVE_S = 0.05
PROCESSES = ("robot", "wrench", "regulator", "arbiter", "all")
# Of even and odd seeds. The deadlines are longer than all but the longest stall, which mostly ends
# in a hold: the others show what the laws do.
DEADLINES = {"command_s": 0.1, "sensor_s": 0.1}
STALLS_MS = ((10, 30, 60), (10, 30, 60, 120))
PAUSE_S = (0.15, 0.6)  # between two stalls
# Of the seeds in turn: time from the beginning of a stall to the start that releases; None: the
# running force feedback releases.
START_LEADS_S = (None, None, None, None, -0.006, -0.002, 0.0, 0.012)
REST_S = 0.3  # between its stop and its start
MOST_PRESS, MOST_LIFT = 1.3, 0.05  # of the set point
CASES: list[Row] = [
    {"law": law, "stiffness_N_m": stiffness_N_m, "delay_ms": delay_ms}
    for law in ("plain", "adaptive")
    for stiffness_N_m, delay_ms in ((2e4, 10.0), (2.8e4, 41.0))
]


@dataclass(slots=True)
class StalledRun:
    """Extremes of a run, in set points; lift-off is the true distance times the stiffness."""

    press: float = 0.0
    lift: float = 0.0
    held: bool = False  # or the start was refused

    @property
    def is_good(self) -> bool:
        """Whether the force has stayed within its promises."""
        return self.press <= MOST_PRESS and self.lift <= MOST_LIFT


Draw = Callable[[], tuple[int, str, int]]  # pause before a stall [ns], who stands still, how long


class Stalls:
    """Lets processes of a virtual cell stand still, one stall after the other."""

    def __init__(self, world: VirtualCell, draw: Draw) -> None:
        self._draw, self._until_ns = draw, 0
        self._next(world.clock.now_ns())
        for role, runner in world.runners.items():
            self._gate(role, runner)

    def _next(self, now_ns: int) -> None:
        pause_ns, self._who, duration_ns = self._draw()
        self._from_ns = now_ns + pause_ns
        self._until_ns = self._from_ns + duration_ns

    def begin(self, from_ns: int) -> None:
        """Let the next stall begin at a time."""
        self._until_ns += from_ns - self._from_ns
        self._from_ns = from_ns

    def _gate(self, role: str, runner: Runner) -> None:
        step = runner.step

        def gated(now_ns: int) -> bool:
            if now_ns >= self._until_ns:
                self._next(now_ns)
            stands = now_ns >= self._from_ns and self._who in (role, "all")
            return not stands and step(now_ns)

        runner.step = gated  # type: ignore[method-assign]


def drawn(seed: int) -> Draw:
    """Return the stalls of a seed."""
    rng, stalls_ms = random.Random(seed), STALLS_MS[seed % 2]  # noqa: S311 - no secret

    def draw() -> tuple[int, str, int]:
        pause_ns = round(rng.uniform(*PAUSE_S) * NS_PER_S)
        return pause_ns, rng.choice(PROCESSES), rng.choice(stalls_ms) * 1_000_000

    return draw


def armed(cell: CellConfig) -> tuple[VirtualCell, ConfiguredCell]:
    """Return a virtual cell that is tared and armed, and its client."""
    world = VirtualCell(cell)
    client = ConfiguredCell(cell, commander="operator", bus=world.client)
    world.advance(READY_S)
    client.tare()
    client.arm()
    return world, client


def play(case: Row, draw: Draw, start_lead_s: float | None = None) -> StalledRun:
    """Press and release under stalls; after a hold the force is observed for a while.

    Args:
        case: Law and contact.
        draw: The stalls.
        start_lead_s: Time from the beginning of a stall to the start that releases [s], negative
            if the start is first; None: the running force feedback releases.
    """
    trial = DemoOverrides(
        stiffness_N_m=case["stiffness_N_m"], delay_s=case["delay_ms"] / 1e3, law=case["law"]
    )
    cell = demo_cell(CELL, trial).model_copy(update={"deadlines": Deadlines(**DEADLINES)})
    (world, client), found = armed(cell), StalledRun()
    client.force.start(SETPOINT_N)
    world.advance(APPROACH_S, lambda: world.arm.lift_off_m < NEAR_M)
    stalls = Stalls(world, draw)
    observe = partial(_observe, world, client, found)
    observe(PRESS_S)
    if start_lead_s is not None and not found.held:
        client.force.stop()
        observe(REST_S)
        stalls.begin(world.clock.now_ns() + round(max(0.0, -start_lead_s) * NS_PER_S))
        observe(max(0.0, start_lead_s))
    if not found.held:
        try:
            client.force.start(0.0) if start_lead_s is not None else client.force.set(0.0)
        except RefusedError:  # data are stale: the arm stays where it is
            found.held = True
        observe(RELEASE_S)
    return found


def _observe(world: VirtualCell, client: ConfiguredCell, found: StalledRun, for_s: float) -> None:
    """Let time pass and note the extremes; end a while after a hold."""

    def note() -> bool:
        arm = world.arm
        found.press = max(found.press, hypot(*arm.true_wrench().force_N.tolist()) / SETPOINT_N)
        if found.press > TOUCH_SHARE:
            found.lift = max(found.lift, arm.lift_off_m * stiffness_N_m / SETPOINT_N)
        return False

    stiffness_N_m = world.arm.settings.stiffness_N_m
    end_ns = world.clock.now_ns() + round(for_s * NS_PER_S)
    while world.clock.now_ns() < end_ns:
        left_s = (end_ns - world.clock.now_ns()) / NS_PER_S
        world.advance(min(OBSERVE_S, left_s), note)
        if not found.held and client.status().state not in OPERATIONAL:
            found.held = True
            end_ns = world.clock.now_ns() + round(HELD_S * NS_PER_S)


def _run(job: tuple[Row, int]) -> StalledRun:
    case, seed = job
    return play(case, drawn(seed), START_LEADS_S[seed % len(START_LEADS_S)])


def measure(options: Options) -> Tables:
    """Run every case with every seed."""
    return {"cases": [_row(case, options) for case in CASES]}


def _row(case: Row, options: Options) -> Row:
    jobs = [(case, seed) for seed in range(SEEDS // QUICK_STEP if options.quick else SEEDS)]
    runs = list(options.pool.map(_run, jobs, chunksize=5))
    beyond = sum(not run.is_good for run in runs)
    return {
        **case,
        "runs": len(runs),
        "held_or_refused": sum(run.held for run in runs),
        "largest_press_pct": 100.0 * max(run.press for run in runs),
        "largest_lift_off_pct": 100.0 * max(run.lift for run in runs),
        "beyond": beyond,
        "met": beyond == 0,
    }

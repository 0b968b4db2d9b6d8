"""Load test: a frozen subscriber and a message flood while the arm presses, without effect on it.

`python -m tests.chaos.flood [--seconds 10] [--rate 10000]`. Exit code 0: no
control deadline was missed except where the idle witness missed it too, and no put took long;
otherwise 1.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Health
from tests.chaos.common_net import (
    POLL_S,
    CellUnderTest,
    HarnessError,
    child,
    make_cell,
    run_guarded,
    running_cell,
    table,
)
from tests.chaos.flood_peer import MIXES
from tests.chaos.injector import state_of
from tests.chaos.witness import Witness, witness

PRESS_N = 10.0
SETTLE_S = 3.0  # of the press, before the evaluation
QUIET_S = 4.0
LATE_S = 0.020  # the shortest deadline permitted in a cell file
PUT_S = 0.005
HEALTH_WINDOW_S = 1.5  # window of a service's longest gap, plus the time until it is received
# Minimum share of the requested rate, on two cores shared with the cell: a query costs its sender
# ten times as much as a message.
LEAST_SHARE = {"messages": 0.95, "mixed": 0.1, "questions": 0.1}
HEAD = ("what", "loop", "longest gap ms", "overdue", "longest put ms", "witness ms", "")
CONTROL = [role for role in topics.ROLES if role != "hub"]


@dataclass(frozen=True, slots=True)
class TimingLimits:
    """Limits [s]: gap between two steps of a control loop, and duration of a put."""

    gap_s: float = LATE_S
    put_s: float = PUT_S


@dataclass(slots=True)
class Loop:
    """Timing of one service during a phase, from its health reports."""

    role: str
    bounds: TimingLimits = TimingLimits()
    gap_s: float = 0.0
    overdue: int = 0  # reports with a gap not explained by a machine stall
    put_s: float = 0.0
    slow_puts: int = 0
    reports: int = 0

    def take(self, health: Health, at_ns: int, watch: Witness) -> None:
        """Evaluate one report."""
        self.reports += 1
        put_s = health.numbers.get("put_max_s", 0.0)
        self.gap_s, self.put_s = max(self.gap_s, health.longest_gap_s), max(self.put_s, put_s)
        late, slow = health.longest_gap_s > self.bounds.gap_s, put_s > self.bounds.put_s
        if late or slow:
            since_ns = at_ns - round(HEALTH_WINDOW_S * NS_PER_S)
            stall_s = watch.worst_s(since_ns, at_ns)
            self.overdue += late and stall_s <= self.bounds.gap_s
            self.slow_puts += slow and stall_s <= self.bounds.put_s


@dataclass(slots=True)
class Phase:
    """One load on a pressing cell, with the timing of all control loops."""

    name: str
    loops: dict[str, Loop]
    witness_s: float = 0.0
    held: str = ""  # cause of a hold during the phase; a failure unless the machine stalled
    mistakes: list[str] = field(default_factory=list)

    def rows(self) -> list[tuple[object, ...]]:
        """Return the rows of the table."""
        witness_ms = f"{self.witness_s * 1e3:.1f}"
        rows: list[tuple[object, ...]] = []
        for loop in self.loops.values():
            gap_ms, put_ms = f"{loop.gap_s * 1e3:.1f}", f"{loop.put_s * 1e3:.2f}"
            verdict = "LATE" if loop.overdue or loop.slow_puts else "ok"
            rows.append((self.name, loop.role, gap_ms, loop.overdue, put_ms, witness_ms, verdict))
        return rows

    def judge(self, command_s: float) -> None:
        """Record the mistakes; a hold is none when the machine stalled for its deadline."""
        if self.held and self.witness_s <= command_s:
            self.mistakes.append(f"{self.name}: the arm was held: {self.held}")
        for loop in self.loops.values():
            gap_ms, put_ms = loop.gap_s * 1e3, loop.put_s * 1e3
            rules = (
                (not loop.reports, "reported nothing"),
                (loop.overdue, f"was late {loop.overdue} times, {gap_ms:.0f} ms"),
                (loop.slow_puts, f"took {put_ms:.1f} ms for a put"),
            )
            self.mistakes += [f"{self.name}: {loop.role} {text}" for wrong, text in rules if wrong]


class HealthMonitor:
    """Monitor of every service's health during a phase."""

    def __init__(
        self, cell: CellUnderTest, watch: Witness, bounds: TimingLimits = TimingLimits()
    ) -> None:
        """Subscribe."""
        self.cell, self._witness, self._bounds = cell, watch, bounds
        self._health = {role: cell.client.reader(topics.HEALTH[role]) for role in CONTROL}

    def watch(self, name: str, busy: Callable[[], bool]) -> Phase:
        """Monitor until `busy` returns False; the arm must press throughout."""
        phase = Phase(name, {role: Loop(role, self._bounds) for role in CONTROL})
        began_ns = last_ns = time.monotonic_ns()
        while busy():
            now_ns = time.monotonic_ns()
            self._evaluate(phase, now_ns)
            if self.cell.state != "ACTIVE":
                phase.held = self.cell.causes() or "silent"
                break
            last_ns = now_ns
            time.sleep(POLL_S)
        time.sleep(HEALTH_WINDOW_S / 2)  # wait for the last reports
        self._evaluate(phase, last_ns)
        phase.witness_s = self._witness.worst_s(began_ns, time.monotonic_ns())
        phase.judge(self.cell.cell.deadlines.command_s)
        return phase

    def _evaluate(self, phase: Phase, now_ns: int) -> None:
        for role, reader in self._health.items():
            if reader.poll() and (health := reader.read(now_ns).message) is not None:
                phase.loops[role].take(health, now_ns, self._witness)


def for_s(seconds: float) -> Callable[[], bool]:
    """Return a function that is True for a duration."""
    end_s = time.monotonic() + seconds
    return lambda: time.monotonic() < end_s


def frozen_viewer(watcher: HealthMonitor, path: Path, seconds: float) -> Phase:
    """Freeze and thaw a client that subscribes to all topics."""
    with child("tests.chaos.flood_peer", "viewer", "--cell", path) as viewer:
        if viewer.stdout is None or viewer.stdout.readline().strip() != "viewing":
            raise HarnessError("the viewer did not come up")
        time.sleep(0.5)
        os.kill(viewer.pid, signal.SIGSTOP)
        try:
            phase = watcher.watch("viewer frozen", for_s(seconds))
            if state_of(viewer.pid) != "T":
                phase.mistakes.append("the viewer was not frozen")
        finally:
            os.kill(viewer.pid, signal.SIGCONT)
        thawed = watcher.watch("viewer thawed", for_s(1.0))
    phase.mistakes += thawed.mistakes
    return phase


def flooded(
    watcher: HealthMonitor, path: Path, mix: str, *, seconds: float, rate_hz: int, least_hz: float
) -> tuple[Phase, str]:
    """Let a client flood the bus; return its report of sent messages.

    It is an ordinary process: if the cell needs most of the machine it sends less than requested,
    but at least `least_hz` for the trial to count.
    """
    words = ("flood", "--cell", path, "--mix", mix, "--rate", rate_hz, "--seconds", seconds)
    with child("tests.chaos.flood_peer", *words) as peer:
        phase = watcher.watch(f"flood, {mix}", lambda: peer.poll() is None)
        report = _last_line(peer, seconds + 10.0)
    sent = json.loads(report) if report else {}
    if sent.get("per_s", 0.0) < least_hz:
        phase.mistakes.append(f"no flood: {sent.get('per_s', 0.0):.0f} messages/s")
    return phase, report


def _last_line(peer: subprocess.Popen[str], within_s: float) -> str:
    try:
        peer.wait(within_s)
    except subprocess.TimeoutExpired:
        return ""
    lines = peer.stdout.read().splitlines() if peer.stdout is not None else []
    return lines[-1] if lines else ""


def press_anew(cell: CellUnderTest) -> None:
    """Arm and press, from any state."""
    cell.make_ready()
    cell.press(PRESS_N)
    time.sleep(SETTLE_S)


def run(seconds: float, rate_hz: int) -> tuple[list[Phase], list[str]]:
    """Start a cell, press, and apply both loads."""
    with tempfile.TemporaryDirectory(prefix="forcemesh-flood-") as folder, ExitStack() as exits:
        cell, path = make_cell("demo", Path(folder), {"cell": "flood"})
        watch = exits.enter_context(witness(path.parent))
        under_test = exits.enter_context(running_cell(cell, path))
        watcher = HealthMonitor(under_test, watch)
        under_test.tare()
        press_anew(under_test)
        phases = [watcher.watch("nothing", for_s(min(QUIET_S, seconds)))]
        phases.append(frozen_viewer(watcher, path, 0.8 * seconds))
        sent = []
        for mix in MIXES:
            press_anew(under_test)
            least_hz = LEAST_SHARE[mix] * rate_hz
            phase, report = flooded(
                watcher, path, mix, seconds=seconds, rate_hz=rate_hz, least_hz=least_hz
            )
            phases.append(phase)
            sent.append(f"{mix}: {report}")
        return phases, sent


def main() -> int:
    """Return the exit code of a run."""
    parser = argparse.ArgumentParser(prog="tests.chaos.flood", description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of the flood [s]")
    parser.add_argument("--rate", type=int, default=10_000, help="messages per second")
    given = parser.parse_args()
    return run_guarded(lambda: play(given.seconds, given.rate))


def play(seconds: float, rate_hz: int) -> int:
    """Run, print the table and what was wrong, return the exit code."""
    phases, sent = run(seconds, rate_hz)
    print(table("Frozen viewer and flood", HEAD, [row for p in phases for row in p.rows()]))
    print("\n".join(["the flood sent", *sent]))
    mistakes = [mistake for phase in phases for mistake in phase.mistakes]
    print("\n".join(mistakes) or "no control deadline was missed")
    return 1 if mistakes else 0


if __name__ == "__main__":
    sys.exit(main())

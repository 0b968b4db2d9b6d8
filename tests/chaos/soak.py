"""Soak test: the demo cell at full rate, repeating arm, press, release, move.

`python -m tests.chaos.soak [--minutes 10]`. Exit code 0: no memory growth,
no leaks, no unexpected holds, and the loops were on time; otherwise 1.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Reader
from forcemesh.clock import NS_PER_S
from forcemesh.messages import MAY_MOVE
from forcemesh.topics import Topic
from tests.chaos.common_net import (
    CellUnderTest,
    HarnessError,
    make_cell,
    run_guarded,
    running_cell,
    table,
)
from tests.chaos.witness import STALL_S, Witness, witness

PRESS_N = 20.0
PRESS_S, RELEASE_S = 2.5, 1.5
LIFT_M, LIFT_M_S = 0.01, 0.05
SAMPLE_S = 2.0
POLL_S = 0.0005
WARM_UP_SHARE = 0.2  # of the duration, while buffers and caches fill
GROWTH_B = 1_000_000  # in ten minutes
# Growth in the first seconds after the warm-up: measured 110 to 180 kB in 6 s, 80 kB in 15 s.
FILL_B = 400_000
TEN_MINUTES_S = 600.0
LATE_S = 0.020  # p99.9: the shortest deadline permitted in a cell file
STREAMS: tuple[Topic[Any], ...] = (
    topics.ROBOT_STATE,
    topics.WRENCH,
    topics.REGULATOR_TARGET,
    topics.ROBOT_COMMAND,
)
PAGE_B = 4096
ROLES = [role for role in topics.ROLES if role != "sensor"]  # which the simulated robot implements
HEAD = ("process", "memory MB", "growth kB/10 min", "files", "loop", "late p99.9 ms", "")


@dataclass(slots=True)
class ProcessUsage:
    """Memory and open files of a process, sampled."""

    pid: int
    at_s: list[float] = field(default_factory=list)
    resident_b: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)

    def sample(self, at_s: float) -> None:
        """Take a sample. Raises OSError if the process has ended."""
        pages = Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()[1]
        self.at_s.append(at_s)
        self.resident_b.append(int(pages) * PAGE_B)
        self.files.append(sum(1 for _ in Path(f"/proc/{self.pid}/fd").iterdir()))

    def growth_b(self, over_s: float) -> float:
        """Return the growth per `over_s` after the warm-up, by a linear fit [bytes]."""
        first = int(WARM_UP_SHARE * len(self.at_s))
        slope = np.polyfit(self.at_s[first:], self.resident_b[first:], 1)[0]
        return float(slope) * over_s

    @property
    def leaked(self) -> int:
        """Increase of open files from the warm-up to the end."""
        first = int(WARM_UP_SHARE * len(self.files))
        return max(self.files[first:]) - min(self.files[first:])


class Punctuality:
    """Lateness of a publisher per message, from the stamps of consecutive messages.

    The stamps are the publisher's, so the time of reading does not matter.
    """

    def __init__(self, reader: Reader[Any], period_s: float) -> None:
        """Subscribe to one stream."""
        self._reader, self._period_s = reader, period_s
        self._last: tuple[int, int] | None = None
        self.late_s: list[float] = []

    def poll(self, now_ns: int) -> None:
        """Read the latest message, if any."""
        if not self._reader.poll():
            return
        header = self._reader.read(now_ns).header
        if header is None:
            return
        if self._last is not None and header.seq == self._last[0] + 1:
            gap_s = (header.stamp_ns - self._last[1]) / NS_PER_S
            self.late_s.append(max(0.0, gap_s - self._period_s))
        self._last = header.seq, header.stamp_ns

    def percentile_s(self, percent: float) -> float:
        """Return a percentile of the lateness [s]."""
        return float(np.percentile(self.late_s, percent)) if self.late_s else float("nan")


class Soak:
    """Runs rounds and monitors all processes."""

    def __init__(self, under_test: CellUnderTest, watch: Witness, late_s: float) -> None:
        """Subscribe; take a first sample of all processes."""
        cell: CellConfig = under_test.cell
        self.under_test, self._witness, self._late_s = under_test, watch, late_s
        self.rounds, self.false_holds = 0, 0
        self.excused: list[str] = []
        self.mistakes: list[str] = []
        self.streams = {
            topic.key: Punctuality(under_test.client.reader(topic), 1.0 / cell.rate_hz(topic))
            for topic in STREAMS
        }
        under_test.until(lambda: set(ROLES) <= set(under_test.pids()), "health of all roles")
        pids = under_test.pids()
        self.bodies = {role: ProcessUsage(pids[role]) for role in ROLES}
        self._next_sample_s = 0.0
        self._began_s = time.monotonic()

    def run(self, minutes: float) -> None:
        """Run rounds for a duration."""
        self.under_test.tare()
        self._high_m = self.under_test.height_m() + LIFT_M
        end_s = self._began_s + 60.0 * minutes
        while time.monotonic() < end_s:
            began_ns = time.monotonic_ns()
            if self._is_round_complete():
                self.rounds += 1
            else:
                self._explain(began_ns)

    def _is_round_complete(self) -> bool:
        """Run a round; a hold between two stages shows as a refused request."""
        try:
            return all(self._round())
        except HarnessError:
            if self.under_test.state in MAY_MOVE:
                raise
            return False

    def _round(self) -> Iterator[bool]:
        """Yield after each stage whether the arm may still move."""
        cell = self.under_test
        cell.make_ready()
        cell.press(PRESS_N)
        yield self._live(PRESS_S)
        if cell.force_N < 0.5 * PRESS_N:
            self.mistakes.append(f"round {self.rounds}: pressed with {cell.force_N:.1f} N")
        cell.press(0.0)
        yield self._live(RELEASE_S)
        cell.ask(topics.FORCE_STOP, topics.FORCE_STOP.message())
        cell.move_to(self._high_m, LIFT_M_S)
        yield self._live(2.0 * LIFT_M / LIFT_M_S)

    def _live(self, duration_s: float) -> bool:
        """Monitor for a duration; return whether the arm may still move."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            now_ns = time.monotonic_ns()
            for stream in self.streams.values():
                stream.poll(now_ns)
            at_s = time.monotonic() - self._began_s
            if at_s >= self._next_sample_s:
                self._next_sample_s = at_s + SAMPLE_S
                for body in self.bodies.values():
                    body.sample(at_s)
                if self.under_test.state not in MAY_MOVE:
                    return False
            time.sleep(POLL_S)
        return self.under_test.state in MAY_MOVE

    def _explain(self, began_ns: int) -> None:
        """Count an unexpected hold, unless the machine stalled."""
        stall_s = self._witness.worst_s(began_ns, time.monotonic_ns())
        what = f"round {self.rounds}: {self.under_test.causes()}, witness {stall_s * 1e3:.0f} ms"
        if stall_s > STALL_S:
            self.excused.append(what)
        else:
            self.false_holds += 1
            self.mistakes.append(f"held without need, {what}")

    def judge(self, minutes: float) -> list[tuple[object, ...]]:
        """Return the rows of the table; record mistakes."""
        over_s = max(TEN_MINUTES_S if minutes >= 10 else 60.0 * minutes, 1.0)
        streams = dict(zip(ROLES[1:], STREAMS, strict=True))
        rows: list[tuple[object, ...]] = []
        for role, body in self.bodies.items():
            growth_b, wrong = body.growth_b(over_s), []
            key = streams[role].key if role in streams else "-"
            late_s = self.streams[key].percentile_s(99.9) if role in streams else float("nan")
            if growth_b > most_growth_b(over_s):
                wrong.append(f"grows by {growth_b / 1e3:.0f} kB")
            if body.leaked:
                wrong.append(f"open files differ by {body.leaked}")
            if late_s > self._late_s and self._witness.percentile_s(99.9) < self._late_s:
                wrong.append("late")
            self.mistakes += [f"{role}: {what}" for what in wrong]
            memory_MB, grows_kB = body.resident_b[-1] / 1e6, body.growth_b(TEN_MINUTES_S) / 1e3
            numbers = (f"{memory_MB:.1f}", f"{grows_kB:.0f}", body.files[-1])
            rows.append((role, *numbers, key, f"{late_s * 1e3:.1f}", "; ".join(wrong) or "ok"))
        return rows


def most_growth_b(over_s: float) -> float:
    """Return the permitted growth of a process after the warm-up [bytes]."""
    return min(GROWTH_B, FILL_B + GROWTH_B * over_s / TEN_MINUTES_S)


def soak(
    minutes: float, changes: Mapping[str, object] | None = None, late_s: float = LATE_S
) -> Soak:
    """Start a cell, run the soak test, return the observations.

    Args:
        minutes: Duration of the test.
        changes: Overrides of the demo's cell file.
        late_s: Limit of the lateness of a loop at the 99.9th percentile [s].
    """
    with tempfile.TemporaryDirectory(prefix="forcemesh-soak-") as folder, ExitStack() as exits:
        cell, path = make_cell("demo", Path(folder), {**(changes or {}), "cell": "soak"})
        watch = exits.enter_context(witness(path.parent))
        result = Soak(exits.enter_context(running_cell(cell, path)), watch, late_s)
        result.run(minutes)
        rows = result.judge(minutes)
        print(table(f"Soak of {minutes:g} minutes", HEAD, rows))
        print(
            f"{result.rounds} rounds, {result.false_holds} held without need, "
            f"{len(result.excused)} held in a stall of the machine; "
            f"witness: p99.9 {watch.percentile_s(99.9) * 1e3:.1f} ms, "
            f"{watch.stalls()} stalls above {STALL_S * 1e3:.0f} ms"
        )
        return result


def main() -> int:
    """Return the exit code of a run."""
    parser = argparse.ArgumentParser(prog="tests.chaos.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    minutes = parser.parse_args().minutes
    return run_guarded(lambda: play(minutes))


def play(minutes: float) -> int:
    """Run, print what was wrong, return the exit code."""
    result = soak(minutes)
    print("\n".join([*result.excused, *result.mistakes]) or "no mistakes")
    return 0 if result.rounds and not result.mistakes else 1


if __name__ == "__main__":
    sys.exit(main())

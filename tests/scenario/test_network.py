"""Trouble on cables: the judge, the hop that delays, and one trial in real namespaces.

The whole of it is `make chaos-network`.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.robot.trace import RECORD
from tests.chaos import clocks, network
from tests.chaos.network_judge import (
    MOVES_M_S,
    GroundTruthTrace,
    TrialBounds,
    TrialObservations,
    judge,
)
from tests.chaos.network_lab import CANNOT_RUN, why_not
from tests.chaos.network_proxy import Delay

ROOT = Path(__file__).parents[2]
BOUNDS = TrialBounds(last_command_s=0.15, still_s=0.35, fastest_m_s=0.05)
BEGAN_NS, HEALED_NS = 10**12, 10**12 + 10**9
MS = 10**6
PATIENCE_S = 90.0


def seen(**changes: object) -> TrialObservations:
    """A fault that held the arm as it should."""
    fields: dict[str, object] = {
        "began_ns": BEGAN_NS,
        "healed_ns": HEALED_NS,
        "accepted_ns": BEGAN_NS + 100 * MS,
        "held": True,
        "causes": "stale",
        "bites": 3,
        "ends": "held",
        "stall_s": 0.0,
    }
    return TrialObservations(**(fields | changes))  # type: ignore[arg-type]


def stops_after(moving_ms: int, speed_m_s: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """A flange that moves for some time after the fault, and then stands: moments, speeds."""
    at_ns = BEGAN_NS + MS * np.arange(-20, 2500, dtype=np.int64)
    return at_ns, np.where(at_ns <= BEGAN_NS + moving_ms * MS, speed_m_s, 0.0)


def travelled(path: Path, ways_rad: np.ndarray) -> GroundTruthTrace:
    """Write the trace of an upright arm whose second joint turns so far in each tick."""
    rows = np.zeros(len(ways_rad), RECORD)
    rows["tick"] = np.arange(len(ways_rad))
    rows["q"][:, 1] = np.cumsum(ways_rad)
    rows.tofile(path)
    return GroundTruthTrace(path)


@pytest.mark.parametrize("ends_at", range(200, 230, 5))
def test_an_arm_that_dashes_and_waits_is_on_its_way(tmp_path, ends_at):
    """A controller stops between its steps: that the arm stands right now says nothing."""
    dashes_rad = np.where(np.arange(ends_at) % 30 < 10, 1e-5, 0.0)  # of some 900 mm
    assert travelled(tmp_path / "t", dashes_rad).speed_now() > MOVES_M_S


def test_an_arm_that_has_stopped_is_not_on_its_way(tmp_path):
    """Nor one that only has a trace of standing, nor one that has none."""
    dash_rad = np.where(np.arange(300) < 190, 1e-5, 0.0)
    assert travelled(tmp_path / "t", dash_rad).speed_now() < MOVES_M_S
    assert travelled(tmp_path / "u", np.zeros(300)).speed_now() == 0.0
    assert GroundTruthTrace(tmp_path / "none").speed_now() == 0.0


def test_a_hold_within_the_bounds_is_no_mistake():
    """The plain case: bitten, held, named, in time, and at rest from then on."""
    verdict = judge(seen(), *stops_after(200), BOUNDS)

    assert verdict.mistakes == ()
    assert (verdict.last_command_ms, verdict.still_ms, verdict.stale) == (100.0, 200.0, 0)


@pytest.mark.parametrize(
    ("changes", "moving_ms", "mistake"),
    [
        ({"bites": 0}, 200, "did not bite"),
        ({"held": False}, 200, "was not held"),
        ({"causes": ""}, 200, "no cause"),
        ({"accepted_ns": BEGAN_NS + 151 * MS}, 200, "executed too late"),
        ({"accepted_ns": None}, 200, "no command is known"),
        ({"accepted_ns": HEALED_NS + MS}, 200, "after the heal"),
        ({"ends": "went on"}, 200, "held without need"),
        ({}, 351, "moved too long"),
        ({}, 2000, "moved too long"),
        ({"ends": "either"}, 600, "moved long after a command"),
        ({"ends": "either", "accepted_ns": None}, 200, "no command is known"),
    ],
)
def test_whatever_is_out_of_bounds_is_a_mistake(changes, moving_ms, mistake):
    """Each promise of the table can be broken, and is told from the others."""
    verdict = judge(seen(**changes), *stops_after(moving_ms), BOUNDS)

    assert any(mistake in each for each in verdict.mistakes), verdict


def test_motion_after_the_heal_counts_although_the_arm_had_stopped():
    """An arm that comes to life again when the cable does has moved too long."""
    at_ns, speed_m_s = stops_after(100)
    speed_m_s[at_ns > HEALED_NS + 400 * MS] = 0.005

    assert "moved too long" in judge(seen(), at_ns, speed_m_s, BOUNDS).mistakes


def test_an_arm_that_goes_on_may_not_jump():
    """A fault that need not hold the arm must not throw it either; and no trace is no proof."""
    calm = judge(seen(ends="either", held=False), *stops_after(2000), BOUNDS)
    wild = judge(seen(ends="either", held=False), *stops_after(2000, 0.06), BOUNDS)
    blind = judge(seen(), np.zeros(0, np.int64), np.zeros(0), BOUNDS)

    assert (calm.mistakes, calm.outcome) == ((), "went on")
    assert any("jumped" in mistake for mistake in wild.mistakes)
    assert "no trace of the arm" in blind.mistakes


@given(
    reads=st.lists(st.tuples(st.integers(0, 40), st.binary(max_size=80)), max_size=40),
    by_ms=st.integers(0, 50),
    jitter_ms=st.integers(0, 50),
)
def test_what_is_delayed_comes_whole_in_order_and_not_too_early(reads, by_ms, jitter_ms):
    """A delaying hop loses, repeats and swaps nothing, whatever it draws."""
    delay = Delay(by_ns=by_ms * MS, jitter_ns=jitter_ms * MS)
    now_ms, went_in, came_out, waiting = 0, bytearray(), bytearray(), bytearray()
    entered_ms: list[int] = []
    for pause_ms, data in reads:
        now_ms += pause_ms
        waiting += data
        went_in += data
        entered_ms += [now_ms] * len(data)
        came_out += b"".join(delay.pass_on(waiting, now_ms * MS))
        assert all(at + by_ms <= now_ms for at in entered_ms[: len(came_out)])
        assert went_in.startswith(came_out)
    came_out += b"".join(delay.pass_on(waiting, (now_ms + by_ms + jitter_ms) * MS))

    assert came_out == went_in


@pytest.mark.parametrize("program", [network, clocks], ids=["network", "clocks"])
def test_without_root_nothing_passes_silently(program, monkeypatch, capsys):
    """Who may not make namespaces is told so, with an exit code of its own."""
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(sys, "argv", ["chaos"])

    assert program.main() == CANNOT_RUN
    assert "NOTHING WAS TESTED" in capsys.readouterr().err


def needs_namespaces() -> pytest.MarkDecorator:
    """Skip, with the reason printed, where the kernel or the user does not allow namespaces."""
    return pytest.mark.skipif(bool(why_not()), reason=why_not() or "namespaces can be made here")


def chaos_network(*words: str) -> list[str]:
    """Return the command line of the harness."""
    return [sys.executable, "-m", "tests.chaos.network", *words]


@pytest.mark.processes
@needs_namespaces()
def test_a_pulled_cable_holds_the_arm(tmp_path):
    """The harness itself, once: the regulator's cable is pulled while the arm approaches."""
    words = chaos_network("--cell", "demo", "--only", "regulator/link-down")
    done = subprocess.run(
        words, cwd=ROOT, timeout=PATIENCE_S, check=False, capture_output=True, text=True
    )

    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 trials, 1 held, 0 went on, 0 out of bounds" in done.stdout


def descendants(pid: int) -> set[int]:
    """Return the processes that a process has started, and theirs."""
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text(encoding="utf-8").rpartition(")")[2].split()[1])
        except OSError:
            continue
        children.setdefault(parent, []).append(int(stat.parent.name))
    todo, found = [pid], set[int]()
    while todo:
        new = set(children.get(todo.pop(), ())) - found
        found |= new
        todo += new
    return found


@pytest.mark.processes
@needs_namespaces()
def test_a_harness_that_is_killed_leaves_nothing_behind():
    """Kill -9 in the middle: every process of it ends, and with them namespaces and cables."""
    harness = subprocess.Popen(
        chaos_network("--cell", "demo", "--only", "regulator/link-down"),
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    give_up_s = time.monotonic() + PATIENCE_S
    while len(started := descendants(harness.pid)) < 8:  # five hosts, and the first services
        assert time.monotonic() < give_up_s
        assert harness.poll() is None
        time.sleep(0.02)
    harness.kill()
    harness.wait()
    while any(Path(f"/proc/{pid}/ns/net").exists() and alive(pid) for pid in started):
        assert time.monotonic() < give_up_s, "something outlived its harness"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    """Tell whether a process still runs; one that only waits to be collected does not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in "ZX"

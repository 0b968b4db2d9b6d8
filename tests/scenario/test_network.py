"""Network faults: their evaluation, the delaying hop, and one trial in real namespaces.

The whole test is `python -m tests.chaos.network`.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.chaos.network_judge import TrialBounds, TrialObservations, judge
from tests.chaos.network_lab import why_not

ROOT = Path(__file__).parents[2]
BOUNDS = TrialBounds(last_command_s=0.15, still_s=0.35, fastest_m_s=0.05)
BEGAN_NS, HEALED_NS = 10**12, 10**12 + 10**9
MS = 10**6
PATIENCE_S = 90.0


def observations(**changes: object) -> TrialObservations:
    """Return the observations of a fault that held the arm as expected."""
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
    """Return a flange that moves for some time after the fault, then rests: times, speeds."""
    at_ns = BEGAN_NS + MS * np.arange(-20, 2500, dtype=np.int64)
    return at_ns, np.where(at_ns <= BEGAN_NS + moving_ms * MS, speed_m_s, 0.0)


def test_a_hold_within_the_bounds_is_no_violation():
    """Effective, held, named, in time, and at rest from then on; an arm may continue slowly."""
    verdict = judge(observations(), *stops_after(200), BOUNDS)
    assert verdict.mistakes == ()
    assert (verdict.last_command_ms, verdict.still_ms, verdict.stale) == (100.0, 200.0, 0)
    calm = judge(observations(ends="either", held=False), *stops_after(2000), BOUNDS)
    assert (calm.mistakes, calm.outcome) == ((), "went on")


@pytest.mark.parametrize(
    ("changes", "moving_ms", "mistake"),
    [
        ({"bites": 0}, 200, "had no effect"),
        ({"held": False}, 200, "was not held"),
        ({"causes": ""}, 200, "no cause"),
        ({"accepted_ns": BEGAN_NS + 151 * MS}, 200, "executed too late"),
        ({"accepted_ns": None}, 200, "no command was recorded"),
        ({"accepted_ns": HEALED_NS + MS}, 200, "after the heal"),
        ({"ends": "went on"}, 200, "held without need"),
        ({}, 351, "moved too long"),
        ({}, 2000, "moved too long"),
        ({"ends": "either"}, 600, "moved long after a command"),
        ({"ends": "either", "accepted_ns": None}, 200, "no command was recorded"),
    ],
)
def test_every_value_out_of_bounds_is_a_violation(changes, moving_ms, mistake):
    """Each bound of the table can be violated; a jump and a missing trace are violations too."""
    verdict = judge(observations(**changes), *stops_after(moving_ms), BOUNDS)
    assert any(mistake in each for each in verdict.mistakes), verdict
    wild = judge(observations(ends="either", held=False), *stops_after(2000, 0.06), BOUNDS)
    assert any("jumped" in each for each in wild.mistakes)
    blind = judge(observations(), np.zeros(0, np.int64), np.zeros(0), BOUNDS)
    assert "no trace of the arm" in blind.mistakes


def needs_namespaces() -> pytest.MarkDecorator:
    """Return a skip, with its reason, where kernel or user do not permit namespaces."""
    return pytest.mark.skipif(bool(why_not()), reason=why_not() or "namespaces can be made here")


def chaos_network(*words: str) -> list[str]:
    """Return the command line of the harness."""
    return [sys.executable, "-m", "tests.chaos.network", *words]


@pytest.mark.processes
@needs_namespaces()
def test_a_pulled_cable_holds_the_arm(tmp_path):
    """The harness itself, once: the regulator's cable is unplugged while the arm approaches."""
    words = chaos_network("--cell", "demo", "--only", "regulator/link-down")
    done = subprocess.run(
        words, cwd=ROOT, timeout=PATIENCE_S, check=False, capture_output=True, text=True
    )

    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 trials, 1 held, 0 went on, 0 out of bounds" in done.stdout

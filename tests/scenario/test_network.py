"""Network faults: one trial in real namespaces.

The whole test is `python -m tests.chaos.network`.
"""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.chaos.network_judge import TrialBounds, TrialObservations, judge
from tests.chaos.network_lab import why_not

ROOT = Path(__file__).parents[2]
BOUNDS = TrialBounds(last_command_s=0.15, still_s=0.35, fastest_m_s=0.05)
BEGAN_NS, HEALED_NS, MS = 10**12, 10**12 + 10**9, 10**6
PATIENCE_S = 90.0


@pytest.mark.parametrize(
    ("changes", "moving_ms", "mistake"),
    [
        ({}, 200, ""),
        ({}, 351, "moved too long"),
        ({"bites": 0}, 200, "had no effect"),
        ({"held": False}, 200, "was not held"),
        ({"causes": ""}, 200, "no cause"),
        ({"accepted_ns": BEGAN_NS + 151 * MS}, 200, "executed too late"),
        ({"accepted_ns": HEALED_NS + MS}, 200, "after the heal"),
        ({"ends": "went on"}, 200, "held without need"),
    ],
)
def test_every_value_out_of_bounds_is_a_violation(changes, moving_ms, mistake) -> None:
    """Each bound can be violated, and a hold within them is no violation."""
    held = TrialObservations(
        BEGAN_NS, HEALED_NS, BEGAN_NS + 100 * MS, True, "stale", bites=3, ends="held", stall_s=0.0
    )
    at_ns = BEGAN_NS + MS * np.arange(-20, 2500, dtype=np.int64)
    speeds_m_s = np.where(at_ns <= BEGAN_NS + moving_ms * MS, 0.01, 0.0)
    found = judge(replace(held, **changes), at_ns, speeds_m_s, BOUNDS).mistakes
    assert any(mistake in each for each in found) if mistake else found == ()


@pytest.mark.processes
@pytest.mark.skipif(bool(why_not()), reason=why_not() or "namespaces can be made here")
def test_a_pulled_cable_holds_the_arm(tmp_path):
    """The harness itself, once: the regulator's cable is unplugged while the arm approaches."""
    words = ["-m", "tests.chaos.network", "--cell", "demo", "--only", "regulator/link-down"]
    done = subprocess.run(
        [sys.executable, *words],
        cwd=ROOT, timeout=PATIENCE_S, check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 trials, 1 held, 0 went on, 0 out of bounds" in done.stdout

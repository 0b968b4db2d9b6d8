"""Bare chains forward every message in order of time, and the load of a process is its own."""

import subprocess
import sys
import time

import numpy as np
import pytest

from bench.chain import bare
from bench.chain.bare import CHAINS
from bench.chain.cell import CellRun
from bench.chain.compare import (
    OTHERS,
    USUAL,
    Comparison,
    cell_of,
    limits,
    step_times_us,
)
from bench.chain.load import Load, _threads, measured

RATE_HZ, DURATION_S = 100.0, 0.5


@pytest.mark.processes
@pytest.mark.parametrize("kind", CHAINS)
def test_a_bare_chain_forwards_what_its_source_sends(kind: bare.ChainKind) -> None:
    """Nearly every message arrives, later than it was sent, and every process has run."""
    times_us, load = bare.run(kind, cell_of(USUAL), RATE_HZ, DURATION_S, realtime=False)
    # Zenoh may drop a message of a reader that the machine stopped; the others lose none.
    sent = (DURATION_S + bare.WARM_UP_S) * RATE_HZ
    assert len(times_us) == pytest.approx(sent, abs=0.5 * sent if kind == "zenoh" else 1)
    assert np.all(times_us > 0.0)
    names = {"source", "sink", *(f"forwarder {number}" for number in (1, 2, 3))}
    assert load.keys() == names | ({"hub"} if kind == "zenoh" else set())
    assert all(each.wakeups_hz > 0.0 for name, each in load.items() if name != "hub")


@pytest.mark.processes
def test_the_load_of_a_process_is_its_share_of_a_core() -> None:
    """A loop without waiting takes more processor time than one that sleeps."""
    codes = {"busy": "while True: pass", "idle": "import time; time.sleep(60)"}
    running = {name: subprocess.Popen([sys.executable, "-c", code]) for name, code in codes.items()}

    def wait() -> None:
        while sum(cpu_s for cpu_s, _ in _threads(running["busy"].pid).values()) < 0.2:
            time.sleep(0.01)

    load = measured({name: each.pid for name, each in running.items()}, wait)
    for each in running.values():
        each.kill()
        each.wait()
    assert load["busy"].cpu_pct > load["idle"].cpu_pct
    assert sum(load["busy"].threads_pct.values()) == pytest.approx(load["busy"].cpu_pct)


def test_a_hop_is_the_difference_of_ages_of_the_same_sample() -> None:
    """Samples that a stage did not use are left out of its hops."""
    ages = {"wrench": {1: 10.0, 2: 11.0}, "regulator": {2: 31.0}, "robot": {2: 40.0, 3: 5.0}}
    hops = {name: us.tolist() for name, us in CellRun(ages_us=ages).hops_us().items()}
    assert hops == {"sensor to wrench": [10.0, 11.0], "wrench to regulator": [20.0],
                    "regulator to robot": [9.0]}  # fmt: skip


def test_a_case_in_which_the_arm_held_is_a_row_with_the_reason() -> None:
    """It has no times of the cell; the case before it keeps its own."""
    ages = {stage: {1: 10.0, 2: 30.0} for stage in ("wrench", "regulator", "arbiter", "robot")}
    load = {"one": Load(20.0, 100.0, {"main": 20.0})}
    bares = {kind: [(np.array([10.0, 20.0]), load)] for kind in CHAINS}
    pressed = CellRun(load=load, ages_us=ages)
    usual = Comparison(USUAL, [pressed], [], bares, engine_pct=5.0).case_row()
    held = Comparison(OTHERS[0], [], ["robot silent"], bares, engine_pct=5.0).case_row()
    assert (usual["processor_core_pct"], usual["cpu_ratio"], usual["held"]) == (15.0, 0.75, "")
    assert held == {**OTHERS[0], "held": "robot silent"}


def test_a_ratio_above_its_limit_is_not_met() -> None:
    """Processor time has a limit of its own."""
    found = limits({"cpu_ratio": 3.7, "p50_ratio": 1.0, "p99_ratio": 3.2})
    assert [each["met"] for each in found] == [False, True, True]


def test_every_step_of_a_service_is_timed() -> None:
    """At 250 Hz."""
    times_us = step_times_us("arbiter", 0.05)
    assert len(times_us) > 10
    assert min(times_us) > 0.0

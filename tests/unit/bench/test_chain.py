"""Bare chains forward every message in order of time, and the load of a process is its own."""

import subprocess
import sys
import time

import numpy as np
import pytest

from bench.chain import bare
from bench.chain.cell import CellRun
from bench.chain.compare import KINDS, Case, Comparison
from bench.chain.load import Load, _threads, measured
from bench.chain.page import page

RATE_HZ, DURATION_S = 100.0, 0.5


@pytest.mark.processes
@pytest.mark.parametrize("kind", KINDS)
def test_a_bare_chain_forwards_what_its_source_sends(kind: bare.Kind) -> None:
    """Nearly every message arrives, later than it was sent, and every process has run."""
    times_us, load = bare.run(kind, Case().cell(), RATE_HZ, DURATION_S, realtime=False)
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
    load: dict[str, Load] = {}
    with measured({name: each.pid for name, each in running.items()}, load):
        while sum(cpu_s for cpu_s, _ in _threads(running["busy"].pid).values()) < 0.2:
            time.sleep(0.01)
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
    bares = {kind: [(np.array([10.0, 20.0]), load)] for kind in KINDS}
    pressed = CellRun(load=load, ages_us=ages)
    usual = Comparison(Case(), [pressed], [], bares, engine_pct=5.0)
    held = Comparison(Case(busy_loops=4), [], ["robot silent"], bares, engine_pct=5.0)
    rows = [
        line for line in page([usual, held], "").splitlines() if line.startswith("| sensor 500")
    ]
    assert [line.split("|")[2].strip() for line in rows] == ["15", "held: robot silent"]
    assert len({line.count("|") for line in rows}) == 1
    assert held.numbers() == {"case": usual.numbers()["case"] | {"busy_loops": 4},
                              "held": ["robot silent"]}  # fmt: skip

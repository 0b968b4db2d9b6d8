"""The main job in real processes over real sockets, and the death of each process."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from common.bus.cell_bus import open_bus
from common.config.load import dump_cell, load_cell
from forcemesh import topics
from tests.chaos.common_net import CellUnderTest

ROOT = Path(__file__).parents[2]
PATIENCE_S = 60.0  # of the test, not of the cell: a loaded machine is slow to start processes

pytestmark = pytest.mark.processes


def forcemesh(*words: object) -> list[str]:
    """Return the command line of a verb."""
    return [sys.executable, "-m", "cli", *(str(word) for word in words)]


def demo_words(cell_file: Path, *words: object) -> tuple[object, ...]:
    """Return the arguments of a demo on the cell of this test."""
    out = cell_file.parent / "out"
    return ("-m", "cli", "demo", "--cell", cell_file, "--json", "--out", out, *words)


def test_the_main_job_settles_in_real_processes(cell_file, start):
    """One process for each service does the same as one process in test_demo_virtual.py."""
    words = ("--mode", "position", "--stiffness", 5e3, "--delay-ms", 0)
    demo = start(*demo_words(cell_file, *words))
    out, err = demo.communicate(timeout=2 * PATIENCE_S)

    result = json.loads(out)
    assert demo.returncode == 0, err
    assert result["settled"]
    assert result["overshoot_pct"] <= 5.0
    assert result["peak_force_N"] == pytest.approx(30.0, abs=2.0)
    assert result["chain_latency_us_p50"] < result["chain_latency_us_p99"]
    assert (cell_file.parent / "out" / "demo.png").stat().st_size > 10_000


def test_the_main_job_settles_through_the_program_that_users_load(tcp_cell_file, start):
    """Gateway, TCP, emulated controller with the shipped forcemesh.as: force goes to zero.

    Force feedback runs in the controller; host pc and the other combinations are in `make
    bench ARGS=over-tcp`.
    """
    demo = start(*demo_words(tcp_cell_file, "--host", "controller"))
    out, err = demo.communicate(timeout=2 * PATIENCE_S)

    result = json.loads(out)
    assert demo.returncode == 0, err
    assert result["settled"]
    assert result["final_force_N"] <= 1.0


def status_of(cell_file: Path) -> dict:
    """Return the output of `forcemesh status --json`."""
    command = forcemesh("status", "--json", "--cell", cell_file)
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    return json.loads(done.stdout)


@pytest.mark.parametrize("together", [[], ["wrench", "regulator"]], ids=["alone", "together"])
def test_killing_a_process_holds_the_arm_and_status_names_it(cell_file, start, together):
    """Kill -9 while force feedback runs: the arm stands, and the screen names the ended process.

    `make nightly ARGS=chaos` does it to all of them.
    """
    cell = load_cell(cell_file, {"together": together})
    cell_file.write_text(dump_cell(cell), encoding="utf-8")
    # The run must outlast this test: status does not report the ended processes of an ended run.
    # Ctrl-C ends it.
    demo = start(*demo_words(cell_file, "--linger", 10 * PATIENCE_S))
    with open_bus(cell, topics.CLIENT, patience_s=PATIENCE_S) as bus:
        client = CellUnderTest(cell, bus)
        presses = lambda: client.state == "ACTIVE" and "regulator" in client.pids()  # noqa: E731
        client.until(presses, "force feedback", PATIENCE_S)
        os.kill(client.pids()["regulator"], signal.SIGKILL)
        client.until(lambda: client.held, "a hold", PATIENCE_S)
        time.sleep(0.5)  # to brake
        before = client.joints()
        time.sleep(0.3)
        assert np.abs(client.joints() - before).max() < 1e-4
        assert client.held
    status = status_of(cell_file)
    demo.send_signal(signal.SIGINT)
    _, err = demo.communicate(timeout=PATIENCE_S)

    ended = {service["name"]: service for service in status["services"]}["regulator"]
    assert not ended["alive"]
    assert "SIGKILL" in ended["fault"]
    assert status["state"] in ("HOLDING", "FAULT", "DOWN", "IDLE", "BOOT")
    assert demo.returncode == 1
    assert "SIGKILL" in err

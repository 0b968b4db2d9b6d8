"""`python -m sim.controller FILE.as` as a process for people and for the gateway."""

import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import dump_cell, load_cell
from common.runtime.service import Runner
from common.runtime.stop import StopSignal
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.topics import SENSOR_WRENCH
from sim.as_language.parser import parse
from sim.controller.__main__ import main
from sim.controller.behaviour import behaviour_like
from sim.controller.network import MemoryNetwork
from sim.controller.service import ControllerSensor
from tests.chaos.common_net import free_port
from tests.fakes.as_bench import program

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).resolve().parents[2]
DEADLINE_S = 30.0

ECHO = program(
    'TYPE "ready"',
    "TCP_LISTEN r, 49152",
    "s = 0",
    "WHILE s < 1 DO",
    "TCP_ACCEPT s, 49152, 1",
    "END",
    "n = 0",
    "TCP_RECV r, s, $in[1], n, 5",
    "TCP_SEND r, s, $in[1], n",
    "TCP_CLOSE r, s",
    "TCP_END_LISTEN r, 49152",
)


def command(*words: str) -> list[str]:
    """Return the command line of the emulator."""
    return [sys.executable, "-m", "sim.controller", *words]


@pytest.mark.processes
def test_a_file_runs_in_real_time_and_answers_on_its_port(tmp_path: Path) -> None:
    """It prints its state, echoes bytes and ends with exit code 0."""
    file = tmp_path / "echo.as"
    file.write_text(ECHO, encoding="ascii")
    with subprocess.Popen(
        command(str(file), "--port", "0"), cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        port, lines = 0, []
        while not port:
            lines.append(process.stdout.readline())
            assert lines[-1], lines
            port = int(lines[-1].split()[-1]) if "listening on" in lines[-1] else 0
        with socket.create_connection(("127.0.0.1", port), timeout=DEADLINE_S) as client:
            client.sendall(b"ping")
            assert client.recv(100) == b"ping"
        assert process.wait(DEADLINE_S) == 0
    assert "ready\n" in lines


def run_here(folder: Path, source: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run a file to its end in this process, as the command does; return the exit code."""
    monkeypatch.setattr("sim.controller.run.stop_on_signals", StopSignal)
    file = folder / "broken.as"
    file.write_text(source, encoding="ascii")
    try:
        return main([str(file)])
    except SystemExit as ended:
        return int(ended.code or 0)


@pytest.mark.parametrize(
    ("source", "expected", "code"),
    [
        (program("x = 1", "y = 1/0"), ("(E0108)", "program main, step 2: y = 1/0"), 1),
        (program("x = = 1"), ("broken.as:2",), 2),
        ("", ("there is no program",), 2),
    ],
)
def test_an_error_is_reported_with_its_place(
    source: str, expected: tuple[str, ...], code: int, tmp_path: Path, monkeypatch, capsys
) -> None:
    """Code, program and step of a running program; file and line of one that does not load."""
    assert run_here(tmp_path, source, monkeypatch) == code
    printed = "".join(capsys.readouterr())
    assert all(text in printed for text in expected), printed


@pytest.mark.parametrize(
    ("lines", "code"),
    [((), 1), (("PCEXECUTE 2: reset", "TWAIT 0.1"), 0)],
    ids=["standing", "reset"],
)
def test_a_program_that_goes_on_after_an_error_is_not_ended(
    lines: tuple[str, ...], code: int, tmp_path: Path, monkeypatch, capsys
) -> None:
    """An error of a PC program ends that one; the exit code is that of the error at the end."""
    main_program = program("PCEXECUTE 1: bad", "TWAIT 0.2", *lines, 'TYPE "after"')
    others = program("x = 1/0", name="bad") + program("MC ERESET", name="reset")
    assert run_here(tmp_path, main_program + others, monkeypatch) == code
    printed = capsys.readouterr().out
    assert "program bad, step 1: x = 1/0" in printed
    assert "after" in printed


@pytest.mark.processes
def test_a_process_like_a_probe_is_probed_over_a_socket(tmp_path: Path) -> None:
    """Stage a of `forcemesh probe`, and the file that it writes."""
    port, out, cell = free_port(), tmp_path / "probe.yaml", tmp_path / "cell.yaml"
    like = tmp_path / "like.yaml"
    like.write_text("behaviour: {step_s: 0.0008, timer_grain_s: 0.02}\n")
    cell.write_text(dump_cell(load_cell(ROOT / "cells/demo-tcp.yaml", {"gateway.port": port})))
    text = (ROOT / "controller" / "fmprobe.as").read_text("ascii").replace("fp.dur=1", "fp.dur=0.3")
    (tmp_path / "fmprobe.as").write_text(text, "ascii")
    words = command(str(tmp_path / "fmprobe.as"), "--port", str(port), "--like", str(like))
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while "stage.a" not in process.stdout.readline():
            pass
        done = subprocess.run(
            [sys.executable, "-m", "cli", "probe", "--to", "a", "--cell", cell, "--out", out],
            cwd=ROOT, capture_output=True, text=True, timeout=DEADLINE_S, check=False,
        )  # fmt: skip
        process.terminate()
    assert done.returncode == 0, done.stderr
    found = behaviour_like(out)
    assert found.step_s == pytest.approx(0.0008, rel=0.1)
    assert found.timer_grain_s == pytest.approx(0.02, rel=0.1)


def demo_cell() -> CellConfig:
    """The demo's cell."""
    return load_cell(ROOT / "cells" / "demo.yaml")


def test_in_a_cell_it_publishes_the_readings_of_the_arm_that_its_program_moves() -> None:
    """The rate is the cell's; pressing down on the plate shows in the force."""
    cell, clock = demo_cell(), ManualClock()
    transport = MemoryTransport()
    bus = Bus("sensor", cell.cell, transport, cell, clock)
    service = ControllerSensor(bus, cell, MemoryNetwork())
    service.machine.load(parse(program("HERE p", "SPEED 20 MM/S", "LMOVE SHIFT(p BY 0,0,-5.5)")))
    service.machine.pendant.monitor_speed(100)
    reader = Bus("wrench", cell.cell, transport, cell, clock).reader(SENSOR_WRENCH)
    runner, forces, counters = Runner(service, [], clock), [], []
    service.machine.pendant.execute("main")
    for _ in range(600):
        clock.sleep_s(0.001)
        runner.step(clock.now_ns())
        if reader.poll():
            message = reader.read(clock.now_ns()).message
            assert message is not None
            forces.append(message.force_N[2])
            counters.append(message.counter)
    assert len(forces) == pytest.approx(0.6 * cell.rates.sensor_hz, abs=2)
    assert counters == list(range(counters[0], counters[0] + len(counters)))
    assert abs(forces[-1] - forces[0]) > 5.0
    assert service.fault == ""
    assert service.counters()["ms_lost"] == 0


def test_a_process_that_stalled_skips_time_instead_of_racing() -> None:
    """After a stall of 3 s it catches up 50 ms and counts the rest."""
    cell, clock = demo_cell(), ManualClock()
    service = ControllerSensor(Bus("sensor", cell.cell, MemoryTransport(), cell, clock), cell,
                               MemoryNetwork())  # fmt: skip
    clock.sleep_s(3.0)
    began = time.monotonic()
    service.step(clock.now_ns())
    assert service.arm.ticks == 50
    assert service.counters()["ms_lost"] == 2950
    assert time.monotonic() - began < DEADLINE_S
    clock.sleep_s(0.010)
    service.step(clock.now_ns())
    assert service.arm.ticks == 60

"""`python -m sim.controller FILE.as` as a process for people and for the gateway."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

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

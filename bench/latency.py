"""Latency of the whole chain in real processes, compared with bare TCP between two processes.

Both are measured in one run, so that the ratio is meaningful on any machine. The two ends of the
bare hop are kept on two cores, as two services mostly are: on one core TCP is ten times faster.
"""

import json
import multiprocessing
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

ROOT = Path(__file__).resolve().parent.parent
ROUNDS = 3000
PACKET = bytes(500)  # about the size of a message on the bus


def table() -> Table:
    """Return one-way times of a bare TCP hop and of every hop of the chain."""
    tcp_us = tcp_hop_us()
    result = demo_result()
    rows = Table(title="latency, p50 / p99", title_justify="left")
    rows.add_column("from, to")
    rows.add_column("us", justify="right")
    rows.add_column("to bare TCP (p50)", justify="right")
    rows.add_row("bare TCP, one way", f"{tcp_us[0]:.0f} / {tcp_us[1]:.0f}", "1.0")
    for hop, (p50, p99) in result["hops_us"].items():
        rows.add_row(hop, f"{p50:.0f} / {p99:.0f}", f"{p50 / tcp_us[0]:.1f}")
    p50, p99 = result["chain_latency_us_p50"], result["chain_latency_us_p99"]
    rows.add_row("whole chain", f"{p50:.0f} / {p99:.0f}", f"{p50 / tcp_us[0]:.1f}")
    return rows


def demo_result() -> dict[str, Any]:
    """Run the demo in real processes and return its numbers."""
    command = [sys.executable, "-m", "cli", "demo", "--json", "--out", "out/bench"]
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def tcp_hop_us() -> tuple[float, float]:
    """Return p50 and p99 of half a round trip over loopback TCP between two processes [us]."""
    listener = socket.create_server(("127.0.0.1", 0))
    echo = multiprocessing.get_context("spawn").Process(
        target=_echo, args=(listener.getsockname()[1],)
    )
    echo.start()
    _stay_on(0)
    connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    times_ns = []
    for _ in range(ROUNDS):
        start_ns = time.monotonic_ns()
        connection.sendall(PACKET)
        _receive(connection)
        times_ns.append((time.monotonic_ns() - start_ns) / 2)
        time.sleep(0.0005)  # the pace of a loop, not of a flood
    connection.close()
    listener.close()
    echo.join()
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    p50, p99 = np.percentile(np.array(times_ns) / 1e3, [50, 99]).tolist()
    return (p50, p99)


def _stay_on(core: int) -> None:
    os.sched_setaffinity(0, {core % (os.cpu_count() or 1)})


def _echo(port: int) -> None:
    _stay_on(1)
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while _receive(connection):
            connection.sendall(PACKET)


def _receive(connection: socket.socket) -> bool:
    missing = len(PACKET)
    while missing:
        data = connection.recv(missing)
        if not data:
            return False
        missing -= len(data)
    return True

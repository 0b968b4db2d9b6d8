"""Subscriber examples in other languages read the bus with Zenoh and MessagePack alone."""

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.bus.cell_bus import open_hub
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import WrenchAtTcp
from tests.chaos.common_net import ROOT, free_port

EXAMPLES = ROOT / "examples" / "subscribers"
BUILD = ROOT / "out" / "subscribers"
THERE = "tcp/127.0.0.1:7447"  # as in the examples
FORCE_N = (1.5, -2.5, 30.25)
PATIENCE_S = 60.0


@pytest.fixture
def endpoint() -> Iterator[str]:
    """Run the hub of the demo cell on a free port and publish one wrench repeatedly."""
    there = f"tcp/127.0.0.1:{free_port()}"
    cell = load_cell(ROOT / "cells" / "demo.yaml", {"bus.endpoint": there})
    stop, ready = threading.Event(), threading.Event()

    def publish() -> None:
        with open_hub(cell) as hub:
            publisher = hub.playing("wrench").publisher(topics.WRENCH)
            ready.set()
            while not stop.wait(0.02):
                publisher.put(WrenchAtTcp(force_N=FORCE_N))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        assert ready.wait(PATIENCE_S)
        yield there
    finally:
        stop.set()
        thread.join()


def first_numbers(*command: str | Path) -> tuple[float, ...]:
    """Run a subscriber until it prints a line; return the numbers in it."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        timer = threading.Timer(PATIENCE_S, process.kill)
        timer.start()
        line = process.stdout.readline() if process.stdout else ""
        timer.cancel()
        process.kill()
    return tuple(float(word) for word in line.strip(" []()\n").replace(",", " ").split())


@pytest.mark.realtime
def test_the_python_subscriber_reads_the_force(endpoint: str) -> None:
    """To the last digit, through a hub of ours."""
    text = (EXAMPLES / "python" / "wrench.py").read_text(encoding="utf-8")
    assert first_numbers(sys.executable, "-c", text.replace(THERE, endpoint)) == FORCE_N


@pytest.mark.realtime
@pytest.mark.long
@pytest.mark.cargo
@pytest.mark.timeout(1800)
def test_the_rust_subscriber_reads_the_force(endpoint: str) -> None:
    """It is built for minutes."""
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    folder = BUILD / "rust"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(EXAMPLES / "rust", folder, ignore=shutil.ignore_patterns("target"))
    main = folder / "src" / "main.rs"
    main.write_text(main.read_text(encoding="utf-8").replace(THERE, endpoint), encoding="utf-8")
    target = Path(os.environ.get("CARGO_TARGET_DIR", BUILD / "target"))
    environment = os.environ | {"CARGO_TARGET_DIR": str(target)}
    subprocess.run(["cargo", "build", "--release"], cwd=folder, check=True, env=environment)  # noqa: S607 - of the user
    assert first_numbers(target / "release" / "wrench") == FORCE_N

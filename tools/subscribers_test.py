"""Test of the subscriber examples in other languages: `make test-subscribers`.

Each example is built and run if its tools are installed; missing ones are listed, and the exit
code is 77 if any is missing.
"""

import os
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common.bus.cell_bus import open_hub
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import WrenchAtTcp

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples" / "subscribers"
BUILD = ROOT / "out" / "subscribers"
THERE, KEY = "tcp/127.0.0.1:7447", "demo/wrench"  # as in the examples
FORCE_N = (1.5, -2.5, 30.25)
PATIENCE_S = 60.0
MISSING = 77


@contextmanager
def publishing_hub() -> Iterator[str]:
    """Run the hub of the demo cell on a free port and publish one wrench repeatedly."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    cell = load_cell(ROOT / "cells" / "demo.yaml", {"bus.endpoint": endpoint})
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
        if not ready.wait(PATIENCE_S):
            raise TimeoutError("the hub did not start")
        yield endpoint
    finally:
        stop.set()
        thread.join()


def first_line(command: list[str]) -> str:
    """Run a subscriber until it prints a line, and end it."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    timer = threading.Timer(PATIENCE_S, process.kill)
    timer.start()
    try:
        line = process.stdout.readline() if process.stdout else ""
    finally:
        timer.cancel()
        process.kill()
        _, errors = process.communicate()
    if not line:
        raise RuntimeError(f"{command[0]} printed nothing: {errors}")
    return line


def numbers(line: str) -> tuple[float, ...]:
    """Return the numbers in a line, without the surrounding text."""
    return tuple(float(word) for word in line.strip(" []()\n").replace(",", " ").split())


def rust(endpoint: str) -> list[str] | None:
    """Build the Rust example for a hub; None without cargo."""
    if shutil.which("cargo") is None:
        return None
    folder = BUILD / "rust"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(EXAMPLES / "rust", folder, ignore=shutil.ignore_patterns("target"))
    main = folder / "src" / "main.rs"
    main.write_text(main.read_text(encoding="utf-8").replace(THERE, endpoint), encoding="utf-8")
    target = Path(os.environ.get("CARGO_TARGET_DIR", BUILD / "target"))
    subprocess.run(
        ["cargo", "build", "--release"],  # noqa: S607 - the user's own
        cwd=folder,
        check=True,
        env=os.environ | {"CARGO_TARGET_DIR": str(target)},
    )
    return [str(target / "release" / "wrench")]


def python(endpoint: str) -> list[str]:
    """Return the Python example for a hub."""
    text = (EXAMPLES / "python" / "wrench.py").read_text(encoding="utf-8")
    return [sys.executable, "-c", text.replace(THERE, endpoint)]


def main() -> int:
    """Test each example; return the exit code."""
    with publishing_hub() as endpoint:
        commands = {"python": python(endpoint), "rust": rust(endpoint)}
        missing = [name for name, command in commands.items() if command is None]
        for name, command in commands.items():
            if command is None:
                print(f"SKIPPED {name}: its tools are not installed, so it was NOT tested")
                continue
            found = numbers(first_line(command))
            print(f"{'ok     ' if found == FORCE_N else 'WRONG  '} {name}: {found}")
            if found != FORCE_N:
                return 1
    return MISSING if missing else 0


if __name__ == "__main__":
    sys.exit(main())

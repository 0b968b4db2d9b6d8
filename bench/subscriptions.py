"""Cost of one client's subscriptions at the hub: `python -m bench subscriptions`.

`python -m bench.subscriptions --write` writes the table into docs/network.md.

A hub in a separate process forwards the messages of a cell, 1500 a second, to one reader.
Another client subscribes in different configurations, with wildcards over everything, each for
one round of the same length; the rounds are repeated in turn. Compared within one run are the
processor time of the hub and the latency of a message through it.
"""

import argparse
import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import zenoh
from rich.console import Console
from rich.table import Table

from bench.bare_bus import be_the_hub, opened_session, started
from bench.tables import as_markdown, on_screen
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh.topics import TOPICS
from tools.figures import replace_block

DEMO = Path(__file__).parents[1] / "cells" / "demo.yaml"
PAGE = Path(__file__).parents[1] / "docs" / "network.md"
COMMAND = "python -m bench.subscriptions --write"
COLUMNS = ("additional client", "processor time of the hub", "latency", "declared in")
ROUNDS = 5
ROUND_S = 1.5
RATE_HZ = 1500
SIZE_B = 300
# name: sessions of the client, subscriptions in each
CONFIGURATIONS: dict[str, tuple[int, int]] = {
    "none": (0, 0),
    "1 session, 1 subscription": (1, 1),
    "1 session, 100 subscriptions": (1, 100),
    "1 session, 1000 subscriptions": (1, 1000),
    "4 sessions, 1 subscription each": (4, 1),
    "16 sessions, 1 subscription each": (16, 1),
}


@dataclass(slots=True)
class Measurement:
    """Measurements of one configuration of subscriptions."""

    cpu_s: list[float] = field(default_factory=list)  # of the hub, per 1000 messages
    latency_ms: list[float] = field(default_factory=list)  # of a message, median of a round
    declared_s: list[float] = field(default_factory=list)  # until all were declared


def rows(found: dict[str, Measurement]) -> list[list[str]]:
    """Return a row per configuration, relative to one subscription of one session."""
    base = found["1 session, 1 subscription"]
    return [
        [
            name,
            f"{median(each.cpu_s) / median(base.cpu_s):.2f}",
            f"{median(each.latency_ms) / median(base.latency_ms):.2f}",
            f"{median(each.declared_s) * 1e3:.0f} ms",
        ]
        for name, each in found.items()
    ]


def table() -> Table:
    """Measure, and return the table."""
    return on_screen("cost of a client's subscriptions", COLUMNS, rows(measure()))


def markdown(found: dict[str, Measurement]) -> str:
    """Return the measurements as Markdown for the page."""
    rounds = f"{ROUNDS} rounds of {RATE_HZ * ROUND_S:.0f} messages"
    about = f"{os.cpu_count()} cores, medians of {rounds}; 1.00 is one subscription of one session:"
    return f"{about}\n\n{as_markdown(COLUMNS, rows(found))}"


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(prog="python -m bench.subscriptions", description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write it into docs/{PAGE.name}")
    if parser.parse_args().write:
        replace_block(PAGE, "subscriptions", markdown(measure()), COMMAND)
    else:
        Console().print(table())


def measure() -> dict[str, Measurement]:
    """Measure all configurations several times in turn."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    cell = load_cell(DEMO, {"bus.endpoint": endpoint})
    found = {name: Measurement() for name in CONFIGURATIONS}
    with started(be_the_hub, cell) as pid, _session(cell) as writer, _session(cell) as reader:
        arrived: list[float] = []

        def record_arrival(sample: zenoh.Sample) -> None:
            sent_ns = int.from_bytes(sample.payload.to_bytes()[:8], "little")
            arrived.append((time.monotonic_ns() - sent_ns) * 1e-6)

        kept = reader.declare_subscriber(f"{cell.cell}/{TOPICS[0].key}", record_arrival)
        publishers = [writer.declare_publisher(f"{cell.cell}/{topic.key}") for topic in TOPICS]
        for _ in range(ROUNDS):
            for name, (sessions, each) in CONFIGURATIONS.items():
                with ExitStack() as stack:
                    began_s = time.monotonic()
                    _subscribe(cell, sessions, each, stack)
                    found[name].declared_s.append(time.monotonic() - began_s)
                    time.sleep(0.3)
                    arrived.clear()
                    before_s = _cpu_s(pid)
                    count = _publish(publishers)
                    found[name].cpu_s.append((_cpu_s(pid) - before_s) / count * 1000)
                    found[name].latency_ms.append(median(arrived))
        kept.undeclare()
    return found


def patterns(cell: str) -> list[str]:
    """Return wildcards that differ, everything first: the same one twice is declared once."""
    parts = sorted({word[a:b] for topic in TOPICS for word in topic.key.split("/")
                    for a in range(len(word)) for b in range(a + 1, len(word) + 1)})  # fmt: skip
    return [f"{cell}/**", *(f"{cell}/$*{a}$*/$*{b}$*" for a in parts[::7] for b in parts[::3])]


def _subscribe(cell: CellConfig, sessions: int, each: int, stack: ExitStack) -> None:
    for _ in range(sessions):
        session = stack.enter_context(_session(cell))
        for pattern in patterns(cell.cell)[:each]:
            subscription = session.declare_subscriber(pattern, zenoh.handlers.RingChannel(1))
            stack.callback(lambda _: None, subscription)


def _publish(publishers: list[Any]) -> int:
    """Publish at the rate of a cell for a round; return how many messages."""
    count, began_s = 0, time.monotonic()
    while (passed_s := time.monotonic() - began_s) < ROUND_S:
        while count < passed_s * RATE_HZ:
            stamp = time.monotonic_ns().to_bytes(8, "little")
            publishers[count % len(publishers)].put(stamp + b"\0" * (SIZE_B - 8))
            count += 1
        time.sleep(0.001)
    return count


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _session(cell: CellConfig) -> Iterator[zenoh.Session]:
    session = opened_session(cell)
    try:
        yield session
    finally:
        session.close()


if __name__ == "__main__":
    main()

"""Clients of the load test: a flooding publisher, and a subscriber to be frozen.

python -m tests.chaos.flood_peer flood  --cell FILE --rate 10000 --seconds 10
python -m tests.chaos.flood_peer viewer --cell FILE
"""

import argparse
import json
import os
import time

import zenoh

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.runtime.stop import stop_on_signals
from forcemesh import topics
from forcemesh.zenoh_settings import endpoint_of

BURST_S = 0.001
VIEWER_HOLDS = 64  # capacity of the viewer's channel [samples]
# Of ten messages: numbers of messages to unknown keys, messages to query-only keys, malformed
# queries, and messages longer than any in the bus table.
MIXES = {"messages": (6, 4, 0, 0), "mixed": (4, 2, 3, 1), "questions": (0, 0, 10, 0)}
KINDS = ("unknown", "misplaced", "questions", "large")
SMALL_B, LARGE_B = 100, 32_000
REQUESTS = (topics.GAINS, topics.MOVE, topics.TARE, topics.SPEED, topics.FORCE_START)


def main() -> None:
    """Run one of the two until a stop signal."""
    parser = argparse.ArgumentParser(prog="tests.chaos.flood_peer", description=__doc__)
    parser.add_argument("what", choices=("flood", "viewer"))
    parser.add_argument("--cell", required=True)
    parser.add_argument("--mix", choices=tuple(MIXES), default="mixed")
    parser.add_argument("--rate", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=10.0)
    given = parser.parse_args()
    # Normal scheduling class, as any client, but with the highest priority within it.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if os.geteuid() == 0:
        os.nice(-20)
    cell = load_cell(given.cell)
    with session_of(cell) as session:
        if given.what == "flood":
            sent = flood(
                session, cell, MIXES[given.mix], bursts_hz=given.rate / 10, seconds=given.seconds
            )
            print(json.dumps(sent), flush=True)
        else:
            view(session, cell)


def session_of(cell: CellConfig) -> zenoh.Session:
    """Connect as any client that knows the address of the hub."""
    config = {
        "mode": "client",
        "connect": {"endpoints": [endpoint_of(cell)], "timeout_ms": 5000},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def flood(
    session: zenoh.Session,
    cell: CellConfig,
    mix: tuple[int, ...],
    *,
    bursts_hz: float,
    seconds: float,
) -> dict[str, float]:
    """Send bursts of ten messages at a rate for some time; return what was sent."""
    unknown_n, misplaced_n, questions_n, large_n = mix
    small, large = b"\xc1" * SMALL_B, b"\xc1" * LARGE_B  # 0xC1 is no MessagePack
    publisher = session.declare_publisher
    unknown = [publisher(f"{cell.cell}/flood/{n}") for n in range(unknown_n)]
    misplaced = [publisher(f"{cell.cell}/{request.key}") for request in REQUESTS[:misplaced_n]]
    larges = [publisher(f"{cell.cell}/flood/large/{n}") for n in range(large_n)]
    # A query blocks on congestion unless it may be dropped like the other messages.
    drop = zenoh.CongestionControl.DROP
    askers = [
        session.declare_querier(f"{cell.cell}/{request.key}", timeout=0.5, congestion_control=drop)
        for request in REQUESTS
    ]
    began_s, bursts = time.monotonic(), 0
    while (at_s := time.monotonic() - began_s) < seconds:
        while bursts < at_s * bursts_hz:
            for each in (*unknown, *misplaced):
                each.put(small)
            for n in range(questions_n):
                askers[(bursts + n) % len(askers)].get(_ignore, payload=small)
            for each in larges:
                each.put(large)
            bursts += 1
        time.sleep(BURST_S)
    took_s = time.monotonic() - began_s
    sent = {name: bursts * count for name, count in zip(KINDS, mix, strict=True)}
    return {**sent, "per_s": sum(sent.values()) / took_s, "cpu_s": time.process_time()}


def _ignore(_reply: zenoh.Reply) -> None:
    """Ignore a reply."""


def view(session: zenoh.Session, cell: CellConfig) -> None:
    """Subscribe to all topics and read them until a stop signal."""
    stop = stop_on_signals()
    channel: zenoh.handlers.FifoChannel[zenoh.Sample] = zenoh.handlers.FifoChannel(VIEWER_HOLDS)
    with session.declare_subscriber(f"{cell.cell}/**", channel) as everything:
        print("viewing", flush=True)
        while not stop.is_set():
            if everything.try_recv() is None:
                time.sleep(BURST_S)


if __name__ == "__main__":
    main()

"""The peers of the flood: one that says too much, one that is frozen. Both are ordinary clients.

python -m chaos.flood_peer flood  --cell FILE --rate 10000 --seconds 10
python -m chaos.flood_peer viewer --cell FILE
"""

import argparse
import json
import os
import time

import zenoh

from common import topics
from common.bus import endpoint_of
from common.cell import Cell
from common.config import load_cell
from common.service import stop_on_signals

BURST_S = 0.001
VIEWER_HOLDS = 64  # samples that wait in the viewer's own channel
# Of ten messages: to keys that nobody knows, to keys that only answer questions, questions that no
# service understands, and one that is longer than anything in the bus table.
UNKNOWN, MISPLACED, QUESTIONS, LARGE = 4, 2, 3, 1
SMALL_B, LARGE_B = 100, 32_000
ASKED = (topics.GAINS, topics.MOVE, topics.TARE, topics.SPEED, topics.FORCE_START)


def main() -> None:
    """Be one of the two until told to stop."""
    parser = argparse.ArgumentParser(prog="chaos.flood_peer", description=__doc__)
    parser.add_argument("what", choices=("flood", "viewer"))
    parser.add_argument("--cell", required=True)
    parser.add_argument("--rate", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=10.0)
    given = parser.parse_args()
    # As any program here: only the cell's own processes go before others. But first among those.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if os.geteuid() == 0:
        os.nice(-20)
    cell = load_cell(given.cell)
    with session_of(cell) as session:
        if given.what == "flood":
            print(json.dumps(flood(session, cell, given.rate, given.seconds)), flush=True)
        else:
            view(session, cell)


def session_of(cell: Cell) -> zenoh.Session:
    """Connect as any program may that knows where the hub is."""
    config = {
        "mode": "client",
        "connect": {"endpoints": [endpoint_of(cell)], "timeout_ms": 5000},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def flood(session: zenoh.Session, cell: Cell, rate_hz: int, seconds: float) -> dict[str, float]:
    """Send at a rate for some time; return what was sent."""
    small, large = b"\xc1" * SMALL_B, b"\xc1" * LARGE_B  # 0xC1 is no MessagePack
    sent = dict.fromkeys(("unknown", "misplaced", "questions", "large"), 0)
    began_s, bursts, longest_s = time.monotonic(), 0, 0.0
    while (at_s := time.monotonic() - began_s) < seconds:
        while bursts < at_s * rate_hz / (UNKNOWN + MISPLACED + QUESTIONS + LARGE):
            before_s = time.monotonic()
            for n in range(UNKNOWN):
                session.put(f"{cell.cell}/flood/{n}", small)
            for request in ASKED[:MISPLACED]:
                session.put(f"{cell.cell}/{request.key}", small)
            for n in range(QUESTIONS):
                key = ASKED[(bursts + n) % len(ASKED)].key
                session.get(f"{cell.cell}/{key}", _ignore, payload=small, timeout=0.5)
            session.put(f"{cell.cell}/flood/large", large)
            longest_s = max(longest_s, time.monotonic() - before_s)
            bursts += 1
        time.sleep(BURST_S)
    for name, count in zip(sent, (UNKNOWN, MISPLACED, QUESTIONS, LARGE), strict=True):
        sent[name] = bursts * count
    took_s = time.monotonic() - began_s
    return {**sent, "per_s": sum(sent.values()) / took_s, "longest_burst_s": longest_s}


def _ignore(_reply: zenoh.Reply) -> None:
    """The flood does not listen to answers."""


def view(session: zenoh.Session, cell: Cell) -> None:
    """Subscribe to everything and read it, until told to stop, or frozen from outside."""
    stop = stop_on_signals()
    channel: zenoh.handlers.FifoChannel[zenoh.Sample] = zenoh.handlers.FifoChannel(VIEWER_HOLDS)
    with session.declare_subscriber(f"{cell.cell}/**", channel) as everything:
        print("viewing", flush=True)
        while not stop.is_set():
            if everything.try_recv() is None:
                time.sleep(BURST_S)


if __name__ == "__main__":
    main()

"""Bare chains: a source, three forwarders and a sink in processes of their own, without decoding.

`zenoh` goes through a router with the settings of a cell's hub, as the services do; `pyzmq` and
`tcp` go from each process to the next directly.
"""

import json
import multiprocessing
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Literal, TypeVar

import numpy as np
import zenoh
import zmq

from bench.chain.load import Load, measured, started
from common.bus.cell_bus import hub_settings
from common.config.cell import CellConfig
from common.motion.frames import Array
from common.runtime.realtime import prepare_realtime
from forcemesh.zenoh_session import open_router
from forcemesh.zenoh_settings import client_settings
from tests.chaos.common_net import free_port

T = TypeVar("T")
ChainKind = Literal["zenoh", "pyzmq", "tcp"]
CHAINS: dict[ChainKind, str] = {
    "zenoh": "bare chain over the cell's router",
    "pyzmq": "bare chain over pyzmq",
    "tcp": "bare chain over TCP",
}
Receive = Callable[[], bytes]
Send = Callable[[bytes], object]

FORWARDERS = 3  # wrench, regulator, arbiter
SINK = FORWARDERS + 1
SIZE_B = 308  # a message of a cell
STAMP = struct.Struct("<q")
END = bytes(SIZE_B)
ENDS, END_PAUSE_S = 5, 0.05  # Zenoh may drop one
CONNECT_S = 30.0
WARM_UP_S = 1.0


@dataclass(frozen=True, slots=True)
class Plan:
    """What all processes of a chain know."""

    kind: ChainKind
    cell: CellConfig
    ports: list[int]
    rate_hz: float
    length_s: float
    realtime: bool


def run(
    kind: ChainKind, cell: CellConfig, rate_hz: float, duration_s: float, *, realtime: bool
) -> tuple[Array, dict[str, Load]]:
    """Return the times from source to sink [us], and the load of each process."""
    spawn = multiprocessing.get_context("spawn")
    ports = [free_port() for _ in range(SINK + 1)]
    plan = Plan(kind, cell, ports, rate_hz, duration_s + 2.0 * WARM_UP_S, realtime)
    ready, (ours, theirs) = spawn.Barrier(SINK + 2), spawn.Pipe()
    pids = {}
    with ExitStack() as exits:
        if kind == "zenoh":
            pids["hub"] = exits.enter_context(started(_be_the_hub, plan))
        for number in range(SINK, -1, -1):
            name = {0: "source", SINK: "sink"}.get(number, f"forwarder {number}")
            pids[name] = exits.enter_context(started(_be_a_stage, plan, number, ready, theirs))
        ready.wait(CONNECT_S)
        time.sleep(WARM_UP_S)
        load = measured(pids, lambda: time.sleep(duration_s))
        if not ours.poll(CONNECT_S):
            raise TimeoutError(f"the bare chain over {kind} did not end")
        times_us = np.array(ours.recv()) / 1e3
    return times_us[int(WARM_UP_S * rate_hz) :], load


def _be_the_hub(plan: Plan) -> None:
    """Be a router with the settings of a cell's hub, until the process is terminated."""
    endpoint = plan.cell.bus.endpoint
    with open_router(hub_settings(plan.cell, endpoint), endpoint):
        if plan.realtime:
            prepare_realtime()
        time.sleep(3600.0)


def _be_a_stage(
    plan: Plan, number: int, ready: "multiprocessing.synchronize.Barrier", result: Connection
) -> None:
    """Be one process of a chain; the sink sends the times that it has measured [ns]."""
    with ExitStack() as exits:
        receive, send = LINKS[plan.kind](plan, number, exits)
        if plan.realtime:
            prepare_realtime()
        ready.wait(CONNECT_S)
        if number == 0:
            _emit(send, plan)
        elif number == SINK:
            result.send([*_times_ns(receive)])
        else:
            while data := receive():  # or until the process is ended
                send(data)


def _times_ns(receive: Receive) -> Iterator[int]:
    """Yield the time of each message since it was stamped."""
    while (data := receive()) != END:
        yield time.monotonic_ns() - STAMP.unpack_from(data)[0]


def _emit(send: Send, plan: Plan) -> None:
    """Send stamped messages at a rate, and the end."""
    began_s, padding = time.monotonic(), bytes(SIZE_B - STAMP.size)
    for tick in range(round(plan.length_s * plan.rate_hz)):
        time.sleep(max(0.0, began_s + tick / plan.rate_hz - time.monotonic()))
        send(STAMP.pack(time.monotonic_ns()) + padding)
    for _ in range(ENDS):
        time.sleep(END_PAUSE_S)
        send(END)


def _by_zenoh(plan: Plan, number: int, exits: ExitStack) -> tuple[Receive, Send]:
    settings = json.dumps(client_settings(plan.cell.bus.endpoint, "monitor", {}))
    session = exits.enter_context(
        _tried(lambda: zenoh.open(zenoh.Config.from_json5(settings)), zenoh.ZError)
    )
    subscriber = session.declare_subscriber(f"bare/{number}", zenoh.handlers.RingChannel(1))
    publisher = session.declare_publisher(
        f"bare/{number + 1}",
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )

    def receive() -> bytes:
        return subscriber.recv().payload.to_bytes()

    return receive, publisher.put


def _by_zmq(plan: Plan, number: int, exits: ExitStack) -> tuple[Receive, Send]:
    context = exits.enter_context(zmq.Context())
    pull, push = (exits.enter_context(context.socket(kind)) for kind in (zmq.PULL, zmq.PUSH))
    pull.bind(f"tcp://127.0.0.1:{plan.ports[number]}")
    if number < SINK:
        push.connect(f"tcp://127.0.0.1:{plan.ports[number + 1]}")
    return pull.recv, push.send


def _by_tcp(plan: Plan, number: int, exits: ExitStack) -> tuple[Receive, Send]:
    listener = exits.enter_context(socket.create_server(("127.0.0.1", plan.ports[number])))
    outgoing = incoming = listener
    if number < SINK:
        there = ("127.0.0.1", plan.ports[number + 1])
        outgoing = exits.enter_context(_tried(lambda: socket.create_connection(there), OSError))
        outgoing.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if number > 0:
        incoming = exits.enter_context(listener.accept()[0])
    return lambda: incoming.recv(SIZE_B, socket.MSG_WAITALL), outgoing.sendall


def _tried(attempt: Callable[[], T], fails: type[Exception]) -> T:
    """Return what an attempt returns as soon as it does not fail."""
    give_up_s = time.monotonic() + CONNECT_S
    while True:
        try:
            return attempt()
        except fails:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.1)


LINKS = {"zenoh": _by_zenoh, "pyzmq": _by_zmq, "tcp": _by_tcp}

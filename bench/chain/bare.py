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
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from typing import Literal

import numpy as np
import zenoh
import zmq

from bench.chain.load import Load, measured
from common.bus.cell_bus import hub_settings
from common.config.cell import CellConfig
from common.motion.frames import Array
from common.runtime.realtime import prepare_realtime
from forcemesh.zenoh_settings import client_settings
from tests.chaos.common_net import free_port

Kind = Literal["zenoh", "pyzmq", "tcp"]
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


def run(
    kind: Kind, cell: CellConfig, rate_hz: float, duration_s: float, *, realtime: bool
) -> tuple[Array, dict[str, Load]]:
    """Return the times from source to sink [us], and the load of each process."""
    spawn = multiprocessing.get_context("spawn")
    ports = [free_port() for _ in range(SINK + 1)]
    ready, ours = spawn.Barrier(SINK + 2), spawn.Pipe()
    load: dict[str, Load] = {}
    with ExitStack() as exits:
        pids = {}
        if kind == "zenoh":
            pids["hub"] = exits.enter_context(started(be_the_hub, cell, realtime))
        for number in range(SINK, -1, -1):
            length_s = duration_s + 2.0 * WARM_UP_S
            plan = (kind, number, cell, ports, rate_hz, length_s, realtime, ready, ours[1])
            pids[_name(number)] = exits.enter_context(started(_be_a_stage, *plan))
        ready.wait(CONNECT_S)
        time.sleep(WARM_UP_S)
        with measured(pids, load):
            time.sleep(duration_s)
        if not ours[0].poll(CONNECT_S):
            raise TimeoutError(f"the bare chain over {kind} did not end")
        times_us = np.array(ours[0].recv()) / 1e3
    return times_us[int(WARM_UP_S * rate_hz) :], load


def _name(number: int) -> str:
    return {0: "source", SINK: "sink"}.get(number, f"forwarder {number}")


def _be_a_stage(  # noqa: PLR0917 - the plan of a process
    kind: Kind,
    number: int,
    cell: CellConfig,
    ports: list[int],
    rate_hz: float,
    length_s: float,
    realtime: bool,  # noqa: FBT001
    ready: "multiprocessing.synchronize.Barrier",
    result: Connection,
) -> None:
    """Be one process of a chain; the sink sends the times that it has measured [ns]."""
    with ExitStack() as exits:
        receive, send = LINKS[kind](number, cell, ports, exits)
        if realtime:
            prepare_realtime()
        ready.wait(CONNECT_S)
        if number == 0:
            _emit(send, rate_hz, length_s)
            return
        times_ns: list[int] = []
        while (data := receive()) != END:
            if number < SINK:
                send(data)
            else:
                times_ns.append(time.monotonic_ns() - STAMP.unpack_from(data)[0])
        if number == SINK:
            result.send(times_ns)
        for _ in range(ENDS if number < SINK else 0):
            send(END)
            time.sleep(END_PAUSE_S)


def _emit(send: Send, rate_hz: float, length_s: float) -> None:
    """Send stamped messages at a rate, then the end."""
    began_s, padding = time.monotonic(), bytes(SIZE_B - STAMP.size)
    for tick in range(round(length_s * rate_hz)):
        time.sleep(max(0.0, began_s + tick / rate_hz - time.monotonic()))
        send(STAMP.pack(time.monotonic_ns()) + padding)
    for _ in range(ENDS):
        send(END)
        time.sleep(END_PAUSE_S)


# --- processes and sessions of Zenoh --------------------------------------------------------------


@contextmanager
def started(target: Callable[..., None], *arguments: object) -> Iterator[int]:
    """Run a function in a process of its own during the block; yield its pid."""
    process = multiprocessing.get_context("spawn").Process(
        target=target, args=arguments, daemon=True
    )
    process.start()
    try:
        yield process.pid or 0
    finally:
        process.terminate()
        process.join()


def be_the_hub(cell: CellConfig, realtime: bool) -> None:  # noqa: FBT001 - positional in `started`
    """Be a router with the settings of a cell's hub, until the process is terminated."""
    with zenoh.open(zenoh.Config.from_json5(json.dumps(hub_settings(cell, cell.bus.endpoint)))):
        if realtime:
            prepare_realtime()
        time.sleep(3600.0)


def opened_session(cell: CellConfig) -> zenoh.Session:
    """Return a session on the hub of a cell; wait for the hub."""
    settings = client_settings(cell.bus.endpoint, "monitor", {})
    give_up_s = time.monotonic() + CONNECT_S
    while True:
        try:
            return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
        except zenoh.ZError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.1)


# --- links ----------------------------------------------------------------------------------------


def _by_zenoh(
    number: int, cell: CellConfig, _: list[int], exits: ExitStack
) -> tuple[Receive, Send]:
    session = exits.enter_context(opened_session(cell))
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


def _by_zmq(number: int, _: CellConfig, ports: list[int], exits: ExitStack) -> tuple[Receive, Send]:
    context = exits.enter_context(zmq.Context())
    pull, push = (exits.enter_context(context.socket(kind)) for kind in (zmq.PULL, zmq.PUSH))
    pull.bind(f"tcp://127.0.0.1:{ports[number]}")
    if number < SINK:
        push.connect(f"tcp://127.0.0.1:{ports[number + 1]}")
    return pull.recv, push.send


def _by_tcp(number: int, _: CellConfig, ports: list[int], exits: ExitStack) -> tuple[Receive, Send]:
    listener = exits.enter_context(socket.create_server(("127.0.0.1", ports[number])))
    outgoing = exits.enter_context(_next_socket(ports[number + 1])) if number < SINK else listener
    incoming = exits.enter_context(listener.accept()[0]) if number > 0 else listener
    return lambda: incoming.recv(SIZE_B, socket.MSG_WAITALL), outgoing.sendall


def _next_socket(port: int) -> socket.socket:
    give_up_s = time.monotonic() + CONNECT_S
    while True:
        try:
            found = socket.create_connection(("127.0.0.1", port))
        except OSError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.1)
        else:
            found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return found


LINKS = {"zenoh": _by_zenoh, "pyzmq": _by_zmq, "tcp": _by_tcp}

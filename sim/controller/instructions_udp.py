"""Instructions of UDP, and TCP_STATUS: argument order, ranges, and result variables."""

from sim.controller.instruction import Action
from sim.controller.instructions_tcp import (
    ReadRow,
    Store,
    StoreRow,
    count_of,
    end_of_wait_ns,
    octets_of,
    port_of,
    strings_of,
    wait_for,
)
from sim.controller.motion_requests import checked
from sim.controller.tasks import Task, Wait
from sim.controller.tcp import DEFAULT_TIMEOUT_S, ELEMENT_CHARS, TcpResult


def send_to(
    task: Task,
    store: Store,
    peer: ReadRow,
    port: float,
    elements: ReadRow,
    count: float,
    _timeout_s: float = DEFAULT_TIMEOUT_S,
) -> None:
    """UDP_SENDTO ret,ip[k],port,$a[k],n[,timeout]: a datagram is never waited for."""
    hardware = task.hardware
    strings = strings_of(elements(task, count_of(count)), "UDP_SENDTO needs strings")
    number = int(checked(port, 1, 65535, "port"))
    binds = not hardware.switches["udp_send_nobind"]
    store(task, hardware.udp.send(octets_of(peer(task, 4)), number, strings, binds=binds))


def receive_from(
    task: Task,
    store: Store,
    port: float,
    store_text: StoreRow,
    store_count: Store,
    timeout_s: float = DEFAULT_TIMEOUT_S,
    store_peer: StoreRow | None = None,
    longest: float = float(ELEMENT_CHARS),
) -> Wait | None:
    """UDP_RECVFROM ret,port,$a[k],n[,timeout[,ip[k][,maxlen]]]; n receives the count."""

    def finish(outcome: TcpResult) -> None:
        store_count(task, len(outcome.elements))
        store_text(task, outcome.elements)
        if store_peer is not None and outcome.elements:
            store_peer(task, [float(octet) for octet in outcome.peer])

    chars = int(checked(longest, 1, ELEMENT_CHARS, "the longest element"))
    end_ns = end_of_wait_ns(task, timeout_s)
    operation = task.hardware.udp.receive(port_of(port), end_ns, longest=chars)
    return wait_for(task, store, operation, finish)


def tcp_status(
    task: Task,
    store_count: Store,
    store_ports: StoreRow,
    store_sockets: StoreRow,
    store_errors: StoreRow,
    store_details: StoreRow,
    store_peers: StoreRow,
) -> None:
    """TCP_STATUS n,port[k],sock[k],err[k],suberr[k],$ip[k]: listeners (socket 0) and sockets."""
    rows = task.hardware.tcp.status()
    store_count(task, len(rows))
    store_ports(task, [float(row.port) for row in rows])
    store_sockets(task, [float(row.socket) for row in rows])
    store_errors(task, [float(row.code) for row in rows])
    store_details(task, [0.0 for _ in rows])
    store_peers(task, [".".join(map(str, row.peer)) for row in rows])


INSTRUCTIONS = {
    "UDP_SENDTO": Action(send_to, "vererr"),
    "UDP_RECVFROM": Action(receive_from, "vravrar"),
    "TCP_STATUS": Action(tcp_status, "vaaaaa"),
}

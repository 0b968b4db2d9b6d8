"""UDP unit: semantics of UDP_SENDTO and UDP_RECVFROM, with the codes and polls of the TCP unit.

The first UDP_RECVFROM of a port binds it; what arrived before is lost. A datagram is sent from the
port of the same number if that is bound, and from any free port otherwise or with UDP_SEND_NOBIND.
The strings of one UDP_SENDTO are one datagram. Ports stay bound until the controller is switched
off.
"""

from collections.abc import Sequence

from sim.controller.network import Datagrams, Network, Octets
from sim.controller.tcp import (
    BYTES_PER_CALL,
    CANNOT_CREATE,
    CANNOT_REACH,
    OK,
    TOO_LONG,
    Operation,
    TcpResult,
    poll,
)


class UdpUnit:
    """UDP ports of the controller."""

    def __init__(self, network: Network) -> None:
        """Start without a bound port."""
        self._network = network
        self._bound: dict[int, Datagrams] = {}

    @property
    def bound(self) -> tuple[int, ...]:
        """Bound ports."""
        return tuple(self._bound)

    def send(self, peer: Octets, port: int, elements: Sequence[str], *, binds: bool) -> int:
        """Send strings as one datagram; return the code. `binds`: from the port of this number."""
        data = "".join(elements).encode("latin-1")
        if len(data) > BYTES_PER_CALL:
            return TOO_LONG
        near = self._bound.get(port) if binds else None
        try:
            if near is not None:
                near.send(data, peer, port)
                return OK
            free = self._network.datagrams(0)
            try:
                free.send(data, peer, port)
            finally:
                free.close()
        except OSError:
            return CANNOT_REACH
        return OK

    def receive(self, port: int, end_ns: int, *, longest: int) -> Operation:
        """Wait for a datagram, cut into elements of at most `longest` characters."""
        if port not in self._bound:
            try:
                self._bound[port] = self._network.datagrams(port)
            except OSError:
                return lambda _: TcpResult(CANNOT_CREATE)
        near = self._bound[port]

        def attempt() -> TcpResult | None:
            received = near.receive(BYTES_PER_CALL)
            if received is None:
                return None
            data, peer = received
            text = data.decode("latin-1")
            cuts = range(0, len(text), longest)
            return TcpResult(OK, peer, tuple(text[at : at + longest] for at in cuts))

        return poll(attempt, end_ns)

    def close_all(self) -> None:
        """Release every port."""
        for near in self._bound.values():
            near.close()
        self._bound.clear()

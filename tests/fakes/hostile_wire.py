"""A hostile hop in memory: between gateway and emulated controller on the virtual clock."""

from collections.abc import Callable

from sim.controller.network import LOOPBACK, MemoryNetwork, MemoryStream, Octets
from tests.fakes.hostile_stream import Abuse, Hop, Lane


class PieceStream(MemoryStream):
    """An end that is read piece by piece, as it was written: the least favourable network."""

    def receive(self, most: int) -> bytes | None:
        """Return the oldest piece that waits; see MemoryStream."""
        if not self._inbox or self.cut or self.closed:
            return super().receive(most)
        piece = self._inbox.popleft()
        if piece[most:]:
            self._inbox.appendleft(piece[most:])
        self._held -= len(piece[:most])
        return piece[:most]


class HostileNetwork(MemoryNetwork):
    """A network whose connections all go through a hop; `pump` lets bytes pass."""

    def __init__(self) -> None:
        """Start without an abuse."""
        super().__init__()
        self.hops: list[Hop] = []
        self.standing: dict[str, Callable[[], Abuse]] = {}  # for every new connection
        self._ends: list[tuple[Hop, PieceStream, PieceStream]] = []

    @property
    def hop(self) -> Hop:
        """The newest connection."""
        return self.hops[-1]

    def dial(self, port: int, peer: Octets = LOOPBACK) -> MemoryStream:
        """Connect through a hop. Raises OSError if no process listens."""
        listener = self.listeners.get(port)
        if listener is None:
            raise ConnectionRefusedError(f"no server listens on port {port}")
        near, ours = _pair()
        theirs, far = _pair()
        far.peer = peer
        listener.waiting.append(far)
        hop = Hop()
        for direction, make in self.standing.items():
            hop.lane(direction).abuse = make()
        self.hops.append(hop)
        self._ends.append((hop, ours, theirs))
        return near

    def strike(self, direction: str, abuse: Abuse) -> Abuse:
        """Apply an abuse to one direction of the newest connection from now on."""
        self.hop.lane(direction).abuse = abuse
        return abuse

    def vanish(self) -> None:
        """Pass no more bytes between the ends of the newest connection, without closing it."""
        self.hop.vanished = True

    def intrude(self, port: int, data: bytes) -> MemoryStream:
        """Connect as another client, not through a hop, and send data."""
        stream = super().dial(port)
        stream.send(data)
        self.hops.insert(0, Hop(to_controller=Lane(sent=bytearray(data)), over=True))
        return stream

    def pump(self, now_ns: int) -> None:
        """Let bytes pass."""
        for hop, ours, theirs in self._ends:
            if hop.vanished or hop.over:
                continue
            up_ended = _carry(ours, theirs, hop.to_controller, now_ns)
            down_ended = _carry(theirs, ours, hop.to_gateway, now_ns)
            if hop.cuts:
                ours.reset()
                theirs.reset()
            elif up_ended or down_ended:
                ours.close()
                theirs.close()
            hop.over = ours.closed


def _pair() -> tuple[PieceStream, PieceStream]:
    a, b = PieceStream(), PieceStream()
    a.partner, b.partner = b, a
    return a, b


def _carry(source: PieceStream, sink: PieceStream, lane: Lane, now_ns: int) -> bool:
    """Move bytes from one end to the other; return whether the source has ended and all is sent."""
    ended = False
    try:
        while data := source.receive(65_536):
            lane.push(data)
        ended = data == b""
    except OSError:
        ended = True
    try:
        lane.stuck += lane.pull(now_ns)
        while lane.stuck:
            piece = lane.stuck.popleft()
            rest = piece[sink.send(piece) :]
            if rest:
                lane.stuck.appendleft(rest)
                break
    except OSError:
        return True
    return ended and not lane.waiting and not lane.stuck

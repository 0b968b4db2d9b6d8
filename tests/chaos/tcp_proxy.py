"""A hostile TCP proxy between real sockets: each direction of a connection has an abuse.

    gateway ─TCP─► proxy ─TCP─► controller        one Hop for each connection

It runs in a thread of its own. Each piece is written with a call of its own and without Nagle's
algorithm; the kernel may join the pieces on the other side.
"""

import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from tests.fakes.hostile_stream import Abuse, Hop, Lane

TURN_S = 0.001
CHUNK = 65_536


class HostileProxy:
    """Context manager: listens on `port` and connects on to the port that `upstream` names."""

    def __init__(self, upstream: Callable[[], int | None]) -> None:
        """Listen; `upstream` returns the controller's port, None while it has none."""
        self.hops: list[Hop] = []
        self.standing: dict[str, Callable[[], Abuse]] = {}  # for every new connection
        self._upstream = upstream
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._pairs: list[tuple[Hop, socket.socket, socket.socket]] = []
        self._lock = threading.RLock()  # guards everything above
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "HostileProxy":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._listener.close()
        for _hop, near, far in self._pairs:
            near.close()
            far.close()

    # --- what tests use ---------------------------------------------------------------------------

    @property
    def hop(self) -> Hop:
        """The newest connection."""
        return self.hops[-1]

    def strike(self, direction: str, abuse: Abuse) -> Abuse:
        """Apply an abuse to one direction of the newest connection from now on."""
        with self._lock:
            self.hop.lane(direction).abuse = abuse
        return abuse

    # --- inside -----------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            ends = [end for hop, *pair in self._pairs if not hop.over for end in pair]
            select.select([self._listener, *ends], [], [], TURN_S)
            with self._lock:
                self._accept()
                for hop, near, far in self._pairs:
                    if not hop.over:
                        self._pump(hop, near, far)

    def _accept(self) -> None:
        try:
            near, _ = self._listener.accept()
        except BlockingIOError:
            return
        port = self._upstream()
        try:
            far = socket.create_connection(("127.0.0.1", port or 1), timeout=1.0)
        except OSError:
            near.close()
            return
        hop = Hop()
        for direction, make in self.standing.items():
            hop.lane(direction).abuse = make()
        for end in (near, far):
            end.setblocking(False)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._pairs.append((hop, near, far))
        self.hops.append(hop)

    def _pump(self, hop: Hop, near: socket.socket, far: socket.socket) -> None:
        now_ns = time.monotonic_ns()
        ended = [
            _carry(near, far, hop.to_controller, now_ns),
            _carry(far, near, hop.to_gateway, now_ns),
        ]
        if not (hop.cuts or any(ended)):
            return
        for end in (near, far):
            if hop.cuts:
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            end.close()
        hop.over = True


def _carry(source: socket.socket, sink: socket.socket, lane: Lane, now_ns: int) -> bool:
    """Move bytes from one end to the other; return whether the source has ended and all is sent."""
    ended = False
    try:
        data = source.recv(CHUNK)
        lane.push(data)
        ended = not data
    except BlockingIOError:
        pass
    except OSError:
        ended = True
    lane.stuck += lane.pull(now_ns)
    try:
        with suppress(BlockingIOError):
            while lane.stuck:
                sent = sink.send(lane.stuck[0])
                lane.stuck[0] = lane.stuck[0][sent:]
                if not lane.stuck[0]:
                    lane.stuck.popleft()
    except OSError:
        return True
    return ended and not lane.waiting and not lane.stuck

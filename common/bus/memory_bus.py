"""The bus inside one process: for a whole cell on a virtual clock. Same bytes, no sockets."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from forcemesh.topics import Qos


@dataclass(slots=True)
class MemorySource:
    """Keeps the newest bytes only, or as many as it has room for, as between processes."""

    waiting: deque[bytes] = field(default_factory=lambda: deque(maxlen=1))

    def take(self) -> bytes | None:
        """Return the oldest bytes that wait, once."""
        return self.waiting.popleft() if self.waiting else None

    def wait(self, timeout_s: float) -> None:
        """Nothing comes in while one waits: on a virtual clock somebody else moves the time on."""


@dataclass(slots=True)
class MemoryCall:
    """A request whose answer the asker collects."""

    data: bytes
    reply: bytes | None = None

    def answer(self, data: bytes) -> None:
        """Keep the answer."""
        self.reply = data


@dataclass(slots=True)
class MemoryCalls:
    """Requests in the order of their arrival."""

    waiting: deque[MemoryCall] = field(default_factory=deque)

    def take(self) -> MemoryCall | None:
        """Return the oldest request."""
        return self.waiting.popleft() if self.waiting else None


class MemoryTransport:
    """Everything that is said in one virtual cell. `advance` lets the cell live while one asks."""

    def __init__(self) -> None:
        """Start with an empty bus."""
        self.advance: Callable[[float, Callable[[], bool]], None] | None = None
        self._sources: dict[str, list[MemorySource]] = {}
        self._servers: dict[str, MemoryCalls] = {}

    def publish(self, key: str, _qos: Qos) -> Callable[[bytes], None]:
        """Return the function that puts bytes on a key."""
        sources = self._sources.setdefault(key, [])

        def put(data: bytes) -> None:
            for source in sources:
                source.waiting.append(data)

        return put

    def subscribe(self, key: str, room: int = 1) -> MemorySource:
        """Return a new source of a key."""
        source = MemorySource(deque(maxlen=room))
        self._sources.setdefault(key, []).append(source)
        return source

    def serve(self, key: str) -> MemoryCalls:
        """Return the requests of a key."""
        return self._servers.setdefault(key, MemoryCalls())

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Queue the request and let virtual time pass until it is answered."""
        if key not in self._servers or self.advance is None:
            return None
        call = MemoryCall(data)
        self._servers[key].waiting.append(call)
        self.advance(timeout_s, lambda: call.reply is not None)
        return call.reply

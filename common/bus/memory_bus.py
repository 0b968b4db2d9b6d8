"""In-memory transport: the bus of a whole cell in one process, on a virtual clock."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from forcemesh.topics import Qos


@dataclass(slots=True)
class MemorySource:
    """Source that keeps only the newest payloads, as between processes."""

    waiting: deque[bytes] = field(default_factory=lambda: deque(maxlen=1))

    def take(self) -> bytes | None:
        """Return the oldest waiting payload, or None."""
        return self.waiting.popleft() if self.waiting else None

    def wait(self, timeout_s: float) -> None:
        """Return at once: on a virtual clock the caller advances the time."""


@dataclass(slots=True)
class MemoryCall:
    """A request whose reply the client collects."""

    data: bytes
    reply: bytes | None = None

    def answer(self, data: bytes) -> None:
        """Store the reply."""
        self.reply = data


@dataclass(slots=True)
class MemoryCalls:
    """Requests in the order of their arrival."""

    waiting: deque[MemoryCall] = field(default_factory=deque)

    def take(self) -> MemoryCall | None:
        """Return the oldest request."""
        return self.waiting.popleft() if self.waiting else None


class MemoryTransport:
    """Transport of one virtual cell. `advance` runs the cell while a request is pending."""

    def __init__(self) -> None:
        """Start with an empty bus."""
        self.advance: Callable[[float, Callable[[], bool]], None] | None = None
        self._sources: dict[str, list[MemorySource]] = {}
        self._servers: dict[str, MemoryCalls] = {}

    def publish(self, key: str, _qos: Qos) -> Callable[[bytes], None]:
        """Return the function that publishes bytes on a key."""
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
        """Return the source of requests on a key."""
        return self._servers.setdefault(key, MemoryCalls())

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Queue the request and advance virtual time until the reply."""
        if key not in self._servers or self.advance is None:
            return None
        call = MemoryCall(data)
        self._servers[key].waiting.append(call)
        self.advance(timeout_s, lambda: call.reply is not None)
        return call.reply

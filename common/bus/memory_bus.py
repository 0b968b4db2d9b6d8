"""In-memory transport: the bus of a whole cell in one process, on a virtual clock."""

from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from forcemesh.topics import Qos

T = TypeVar("T")


@dataclass(slots=True)
class MemorySource(Generic[T]):
    """Source of payloads or of requests, in the order of their arrival.

    Of payloads it keeps only the newest, as between processes.
    """

    waiting: deque[T] = field(default_factory=lambda: deque(maxlen=1))

    def take(self) -> T | None:
        """Return the oldest waiting one, or None."""
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


class MemoryTransport:
    """Transport of one virtual cell. `advance` runs the cell while a request is pending."""

    def __init__(self) -> None:
        """Start with an empty bus."""
        self.advance: Callable[[float, Callable[[], bool]], None] | None = None
        self._sources: dict[str, list[MemorySource[bytes]]] = {}
        self._servers: dict[str, MemorySource[MemoryCall]] = {}

    def publish(self, key: str, _qos: Qos) -> Callable[[bytes], None]:
        """Return the function that publishes bytes on a key."""
        sources = self._sources.setdefault(key, [])

        def put(data: bytes) -> None:
            for source in sources:
                source.waiting.append(data)

        return put

    def subscribe(self, key: str, room: int = 1) -> MemorySource[bytes]:
        """Return a new source of a key."""
        source: MemorySource[bytes] = MemorySource(deque(maxlen=room))
        self._sources.setdefault(key, []).append(source)
        return source

    def serve(self, key: str) -> MemorySource[MemoryCall]:
        """Return the source of requests on a key."""
        return self._servers.setdefault(key, MemorySource(deque()))

    def gathered(self) -> AbstractContextManager[None]:
        """Change nothing: here a message costs no wake-up."""
        return nullcontext()

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Queue the request and advance virtual time until the reply."""
        if key not in self._servers or self.advance is None:
            return None
        call = MemoryCall(data)
        self._servers[key].waiting.append(call)
        self.advance(timeout_s, lambda: call.reply is not None)
        return call.reply

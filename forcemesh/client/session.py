"""What every verb of a client needs: its bus, its cell file, feeds made once, and who is silent."""

import threading
from typing import Any, TypeVar

from forcemesh.bus import Bus
from forcemesh.cell_info import CellInfo
from forcemesh.client import ask as asking
from forcemesh.client.feed import Feed
from forcemesh.client.roles import Roles
from forcemesh.clock import Clock
from forcemesh.errors import BusError, LostError
from forcemesh.messages import Asker, Message, Record
from forcemesh.requests import Reply
from forcemesh.topics import ROLES, Request, Topic

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Record)


class Session:
    """One client on one cell's bus. Safe from any thread."""

    def __init__(self, bus: Bus, info: CellInfo, commander: Asker) -> None:
        """Use an open bus; nothing is subscribed to before it is needed."""
        self.bus, self.info, self.commander = bus, info, commander
        self.roles = Roles(bus, info)
        self._lock = threading.Lock()
        self._feeds: dict[str, Feed[Any]] = {}

    @property
    def clock(self) -> Clock:
        """The clock that everything waits by."""
        return self.bus.clock

    def feed(self, topic: Topic[M]) -> Feed[M]:
        """Return the feed of a topic, the same one each time."""
        with self._lock:
            if topic.key not in self._feeds:
                self._feeds[topic.key] = Feed(self.bus, topic, self.lost)
            return self._feeds[topic.key]

    def ask(
        self, request: Request[Q], message: Q, *, within_s: float = 0.0, answer_s: float = 2.0
    ) -> Reply:
        """Ask a service for something.

        Args:
            request: The row of forcemesh/topics.py.
            message: What is asked for.
            within_s: So long to ask again while the refusal is one that time alone mends.
            answer_s: Longest wait for an answer [s].

        Raises:
            RefusedError: The service refuses: code, text, remedy.
            LostError: Nobody answers; says which service is silent.
        """
        try:
            if within_s > 0.0:
                return asking.ask_until(self.bus, request, message, within_s)
            return asking.ask(self.bus, request, message, answer_s)
        except BusError as error:
            raise self.lost(str(error)) from error

    def lost(self, text: str) -> LostError:
        """Return the exception of something that is not heard: it says who is silent, or nobody."""
        silent = self.roles.silent()
        is_all = len(silent) == len(ROLES)
        if is_all:
            who = "nothing is heard of the whole cell: its hub or the network to it is gone"
        elif silent:
            who = f"silent: {', '.join(silent)}"
        else:
            who = "every service is heard"
        return LostError(f"{text} ({who})", silent, is_all=is_all)

"""Client session: bus, facts of the cell, cached feeds, and the list of silent roles."""

import threading
from typing import Any, TypeVar

from forcemesh.bus import Bus
from forcemesh.cell_info import CellInfo
from forcemesh.client.ask import remedy_of, request_in_bounds
from forcemesh.client.feed import Feed
from forcemesh.client.roles import RoleHealth
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.errors import BusError, LostError, RefusedError
from forcemesh.messages import Asker, Message
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.topics import ROLES, Request, Topic

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Record)

ANSWER_S = 2.0
ASK_AGAIN_S = 0.1
TRANSIENT = ("not_ready", "moving", "wait", "late")  # refusals that clear by waiting


class ClientSession:
    """One client on one cell's bus. Thread-safe."""

    def __init__(self, bus: Bus, info: CellInfo, commander: Asker) -> None:
        """Use an open bus; subscribe on demand."""
        self.bus, self.info, self.commander = bus, info, commander
        self.roles = RoleHealth(bus, info)
        self._lock = threading.Lock()
        self._feeds: dict[str, Feed[Any]] = {}

    @property
    def clock(self) -> Clock:
        """Clock of all waits."""
        return self.bus.clock

    def feed(self, topic: Topic[M]) -> Feed[M]:
        """Return the feed of a topic, the same object each time."""
        with self._lock:
            if topic.key not in self._feeds:
                self._feeds[topic.key] = Feed(self.bus, topic, self.lost)
            return self._feeds[topic.key]

    def ask(
        self, request: Request[Q], message: Q, *, within_s: float = 0.0, answer_s: float = ANSWER_S
    ) -> Reply:
        """Send a request and return the reply; repeat it while the refusal is transient.

        Args:
            request: The row of forcemesh/topics.py.
            message: The request.
            within_s: Longest time of repetition [s].
            answer_s: Longest wait for a reply [s].

        Raises:
            DataError: The request is out of its bounds; names argument and value.
            RefusedError: The service refuses: code, text, remedy.
            LostError: No reply within `answer_s`; names the silent services.
        """
        request_in_bounds(message)
        give_up_ns = self.clock.now_ns() + round(within_s * NS_PER_S)
        try:
            while not (reply := self.bus.ask(request, message, answer_s)).accepted:
                if reply.code not in TRANSIENT or self.clock.now_ns() >= give_up_ns:
                    code, text, remedy = reply.code, reply.text, remedy_of(reply.code)
                    raise RefusedError(
                        code, text, remedy=remedy, value=reply.value, limit=reply.limit
                    )
                self.clock.sleep_s(ASK_AGAIN_S)
        except BusError as error:
            raise self.lost(str(error)) from error
        return reply

    def lost(self, text: str) -> LostError:
        """Return the exception of a missing message or reply: it names the silent services."""
        silent = self.roles.silent()
        is_all = len(silent) == len(ROLES)
        if is_all:
            who = "no messages from the whole cell: its hub or the network to it is down"
        elif silent:
            who = f"silent: {', '.join(silent)}"
        else:
            who = "every service is alive"
        return LostError(f"{text} ({who})", silent, is_all=is_all)

"""Contact of the tool for a client: the present state, its changes, and waiting for one."""

import threading
from collections import deque

from forcemesh import topics
from forcemesh.client.feed import FIRST_WITHIN_S, Feed
from forcemesh.client.session import ClientSession
from forcemesh.clock import wait_until
from forcemesh.errors import NotReachedError
from forcemesh.messages import ContactEvent, ContactState
from forcemesh.reader import Reader, Reading

ROOM = 1000  # messages until the next reading: most of them repeat the present state
MOST_KEPT = 256  # changes
CHANGE_POLL_S = 0.002
LONGEST_WAIT_S = 60.0


class ContactEvents:
    """`cell.contact`: changes are kept from the first use on, so that a short one is not missed.

    Thread-safe. Call it for the newest message, as a feed.
    """

    def __init__(self, session: ClientSession) -> None:
        """Use the session of a client; subscribe at the first use."""
        self._session = session
        self.feed: Feed[ContactEvent] = session.feed(topics.CONTACT)
        self._lock = threading.Lock()
        self._reader: Reader[ContactEvent] | None = None
        self._last: Reading[ContactEvent] | None = None
        self._changes: deque[ContactEvent] = deque(maxlen=MOST_KEPT)

    def __call__(self, within_s: float = FIRST_WITHIN_S) -> ContactEvent:
        """Return the newest message; wait for a valid one.

        Raises:
            LostError: No message within `within_s`.
            NotValidError: The state is unknown: an input of the regulator is missing.
        """
        self.changes()
        return self.feed(within_s)

    def changes(self) -> tuple[ContactEvent, ...]:
        """Return the newest message of each state since the first use, oldest first."""
        with self._lock:
            if self._reader is None:
                self._reader = self._session.bus.reader(topics.CONTACT, ROOM)
            while True:
                reading = self._reader.read(self._session.clock.now_ns())
                is_new = self._last is None or reading.header is not self._last.header
                self._last, kept = reading, self._changes
                if reading.message is None or not is_new:
                    return tuple(kept)
                if kept and _place(kept[-1]) == _place(reading.message):
                    kept.pop()
                kept.append(reading.message)

    def wait(
        self,
        *states: ContactState,
        within_s: float = LONGEST_WAIT_S,
        after: ContactEvent | None = None,
    ) -> ContactEvent:
        """Wait for the first of some states; return it, also when it has ended meanwhile.

            before = cell.contact()
            cell.force.start(10.0)
            impact = cell.contact.wait("impact", within_s=20.0, after=before)

        Args:
            states: Such as "impact", or "contact", "sliding".
            within_s: Longest wait [s].
            after: Only later changes count; default: the present state, and what follows.

        Raises:
            NotReachedError: None of them within `within_s`; says what the state is.
            LostError: No message: the regulator is silent.
        """
        present = self.changes()[-1:]
        first = (0, 0) if not present else _place(present[0])
        if after is not None:
            first = after.since_ns, after.number + 1
        found: ContactEvent | None = None

        def is_found() -> bool:
            nonlocal found
            those = (event for event in self.changes() if event.state in states)
            found = next((event for event in those if _place(event) >= first), None)
            return found is not None

        wait_until(self._session.clock, is_found, within_s=within_s, poll_s=CHANGE_POLL_S)
        if found is not None:
            return found
        text, last = f"no {' or '.join(states)} within {within_s:g} s", self._last
        if last is None or last.message is None or last.silent:
            raise self._session.lost(f"{text}: {topics.CONTACT.key} is missing or stale")
        raise NotReachedError(f"{text}: the state of the contact is {last.message.state}")


def _place(event: ContactEvent) -> tuple[int, int]:
    """Return the order of a state among all, also of those of a regulator before a restart."""
    return event.since_ns, event.number

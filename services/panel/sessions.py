"""Login sessions of the panel: the browser's cookie holds a random number, never the token.

A cookie can be copied from a disk, a backup or a log. A copied number opens one panel until that
panel restarts or the session expires; it does not reveal the token of the cell file. Pure.
"""

import hashlib
import secrets
from collections import OrderedDict
from dataclasses import dataclass
from typing import Literal

from forcemesh.clock import NS_PER_S

Rights = Literal["operate", "view"]

SESSION_IDLE_S = 12 * 3600.0  # a working day; an open page polls three times a second
SESSION_LASTS_S = 7 * 24 * 3600.0
MOST_SESSIONS = 64  # sessions; the least recently used one is removed
BYTES = 32


@dataclass(slots=True)
class BrowserSession:
    """Rights of one session, its start and its last use."""

    rights: Rights
    began_ns: int
    used_ns: int

    def ended(self, now_ns: int) -> bool:
        """Return whether the session has exceeded its lifetime or its idle limit."""
        is_old = now_ns - self.began_ns >= SESSION_LASTS_S * NS_PER_S
        return is_old or now_ns - self.used_ns >= SESSION_IDLE_S * NS_PER_S


class Sessions:
    """Session store of one panel: in memory only, the numbers hashed."""

    def __init__(self) -> None:
        """Create an empty store."""
        self._open: OrderedDict[bytes, BrowserSession] = OrderedDict()

    def __len__(self) -> int:
        return len(self._open)

    def begin(self, rights: Rights, now_ns: int) -> str:
        """Open a session; return the number for the browser's cookie."""
        for key in [key for key, session in self._open.items() if session.ended(now_ns)]:
            del self._open[key]
        while len(self._open) >= MOST_SESSIONS:
            self._open.popitem(last=False)
        number = secrets.token_urlsafe(BYTES)
        self._open[_key(number)] = BrowserSession(rights, now_ns, now_ns)
        return number

    def rights(self, number: str, now_ns: int) -> Rights | None:
        """Return the rights of the session with this number, None when there is none."""
        key = _key(number)
        session = self._open.get(key)
        if session is None:
            return None
        if session.ended(now_ns):
            del self._open[key]
            return None
        session.used_ns = now_ns
        self._open.move_to_end(key)
        return session.rights


def _key(number: str) -> bytes:
    return hashlib.sha256(number.encode()).digest()

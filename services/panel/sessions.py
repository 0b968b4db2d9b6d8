"""Who has shown a token: a browser keeps a random number instead of it, for a while.

A cookie can be copied from a disk, a backup or a log. What is copied here opens one panel until it
is started again or the session ends, and never shows the token of the cell file. Pure.
"""

import hashlib
import secrets
from collections import OrderedDict
from dataclasses import dataclass
from typing import Literal

from forcemesh.clock import NS_PER_S

Rights = Literal["operate", "view"]

IDLE_S = 12 * 3600.0  # a working day; an open page asks three times a second
LASTS_S = 7 * 24 * 3600.0
MOST = 64  # the one that was not used for longest goes
BYTES = 32


@dataclass(slots=True)
class Session:
    """Rights, when they began and when they were used last."""

    rights: Rights
    began_ns: int
    used_ns: int

    def ended(self, now_ns: int) -> bool:
        """Tell whether it is too old, or was left alone for too long."""
        is_old = now_ns - self.began_ns >= LASTS_S * NS_PER_S
        return is_old or now_ns - self.used_ns >= IDLE_S * NS_PER_S


class Sessions:
    """The sessions of one panel, in memory alone; their numbers are kept as hashes."""

    def __init__(self) -> None:
        """Begin without any."""
        self._open: OrderedDict[bytes, Session] = OrderedDict()

    def __len__(self) -> int:
        return len(self._open)

    def begin(self, rights: Rights, now_ns: int) -> str:
        """Open a session; return the number for the browser's cookie."""
        self._forget(now_ns)
        while len(self._open) >= MOST:
            self._open.popitem(last=False)
        number = secrets.token_urlsafe(BYTES)
        self._open[_key(number)] = Session(rights, now_ns, now_ns)
        return number

    def rights(self, number: str, now_ns: int) -> Rights | None:
        """Return what a browser with this number may do, None when there is no such session."""
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

    def _forget(self, now_ns: int) -> None:
        for key in [key for key, session in self._open.items() if session.ended(now_ns)]:
            del self._open[key]


def _key(number: str) -> bytes:
    return hashlib.sha256(number.encode()).digest()

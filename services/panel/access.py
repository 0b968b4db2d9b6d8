"""Who may open the panel: every request for the page or its websocket is judged here. Pure.

A browser sends what any page asks it to: also a page of the internet, to this machine's own
address. So the door looks at `Host` (a name that was bent to this address is refused), at `Origin`
(only the panel's own page may talk to the panel), and, where others can reach it, at a token.
"""

import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from common.config.cell_panel import SAME_TOKEN, PanelSection, guessable
from forcemesh.errors import ForcemeshError
from forcemesh.published_ports import PANEL_PUBLISHED, is_loopback
from services.panel.sessions import LASTS_S, Rights

TOKEN_VARIABLE = "FORCEMESH_PANEL_TOKEN"  # noqa: S105 - the name of a variable
ASKED_BY_US = "X-Forcemesh"  # no other page can send this header here: browsers ask first
HERE = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True, slots=True)
class Door:
    """Where the panel listens and whom it lets in."""

    host: str
    port: int
    token: str = ""
    view_token: str = ""
    view_only: bool = False
    published: str = ""  # where others reach it, when it listens in a container

    @property
    def reached_at(self) -> str:
        """Return the address at which others reach it."""
        return self.published or self.host

    def __post_init__(self) -> None:
        """Raise ForcemeshError where others could walk in."""
        if not self.token and not is_loopback(self.reached_at):
            what = "watch the cell" if self.view_only else "move the arm"
            raise ForcemeshError(
                f"refused: on {self.reached_at} anybody in reach could {what}: set panel.token in "
                f"the cell file or {TOKEN_VARIABLE}, or let the panel listen on 127.0.0.1"
            )
        for token in (self.token, self.view_token):
            if why := guessable(token):
                raise ForcemeshError(f"refused: {why}")
        if self.view_token and self.view_token == self.token:
            raise ForcemeshError(f"refused: {SAME_TOKEN}")
        if self.view_token and not self.token:
            raise ForcemeshError(
                "refused: with panel.view_token alone everybody may operate: set panel.token as "
                f"well, or {TOKEN_VARIABLE}"
            )

    @property
    def is_encrypted(self) -> bool:
        """Whether it is served by TLS: wherever others reach it."""
        return not is_loopback(self.reached_at)

    @property
    def cookie(self) -> str:
        """Name of the cookie: a browser has one jar for all ports of a machine.

        The prefix makes a browser take it from this very host and by TLS alone.
        """
        prefix = "__Host-" if self.is_encrypted else ""
        return f"{prefix}forcemesh_panel_{self.port}"

    @property
    def most(self) -> Rights:
        """What an operator may do here."""
        return "view" if self.view_only else "operate"

    def rights(self, shown: str) -> Rights | None:
        """Return what a token opens, None when nothing."""
        if self.token and same(shown, self.token):
            return self.most
        return "view" if self.view_token and same(shown, self.view_token) else None

    def keep(self, number: str) -> str:
        """Return the header that gives a browser the number of its session."""
        kept = f"{self.cookie}={number}; Path=/; Max-Age={round(LASTS_S)}; HttpOnly; "
        return kept + ("SameSite=Strict; Secure" if self.is_encrypted else "SameSite=Strict")

    def stranger(self, headers: Mapping[str, str]) -> str:
        """Say why a request is not of the panel's own page, empty when it is."""
        asked = headers.get("Host", "")
        if not self.token and name_of(asked) not in {*HERE, self.reached_at}:
            return f"this panel is not called {asked!r}: open it by the address that it has printed"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != asked.lower():
            return f"a page of {origin} may not talk to this panel"
        return ""


def door_of(
    section: PanelSection,
    environment: Mapping[str, str],
    *,
    host: str | None = None,
    port: int | None = None,
    view_only: bool = False,
) -> Door:
    """Return the door that a cell file asks for; what is named here goes before it.

    Raises:
        ForcemeshError: Others could reach it and there is no token.
    """
    return Door(
        host=host or section.host,
        port=section.port if port is None else port,
        token=environment.get(TOKEN_VARIABLE) or section.token,
        view_token=section.view_token,
        view_only=view_only,
        published=environment.get(PANEL_PUBLISHED, ""),
    )


def same(shown: str, token: str) -> bool:
    """Compare without telling by the time it takes how much of it was right."""
    return hmac.compare_digest(shown.encode(), token.encode())


def name_of(netloc: str) -> str:
    """Return the name in `name:port`, lower case, without brackets."""
    return (urlsplit(f"//{netloc}").hostname or "").lower()


def token_in(path: str) -> str:
    """Return the token in an address, empty when there is none."""
    return parse_qs(urlsplit(path).query).get("token", [""])[0]


def cookie_in(headers: Mapping[str, str], name: str) -> str:
    """Return a cookie's value, empty when there is none."""
    try:
        jar = SimpleCookie(headers.get("Cookie", ""))
    except CookieError:
        return ""
    return jar[name].value if name in jar else ""

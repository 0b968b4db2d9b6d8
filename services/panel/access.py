"""Access control of the panel: checks every request for the page or its websocket; TLS.

A browser sends requests on behalf of any page, also of a page from the internet to an address of
this machine. Checked are `Host` (against DNS rebinding), `Origin` (against cross-site requests)
and, where other machines can reach the panel, a token.

There TLS is required, too. The page's certificate is issued by a separate authority, `panel-ca`,
which is installed in the browsers. The bus does not trust it, so it can be distributed to every
phone of a lab.
"""

import hmac
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from common.config.cell import CellConfig
from common.config.cell_helpers import SAME_TOKEN, PanelSection, guessable
from forcemesh.errors import ForcemeshError
from forcemesh.identity import PAGE, folder_of
from forcemesh.published_ports import PANEL_PUBLISHED, is_loopback
from services.panel.sessions import SESSION_LASTS_S, Rights

TOKEN_VARIABLE = "FORCEMESH_PANEL_TOKEN"  # noqa: S105 - the name of a variable
ASKED_BY_US = "X-Forcemesh"  # other origins cannot send it: it needs a CORS preflight
HERE = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True, slots=True)
class Door:
    """Listen address of the panel and its tokens."""

    host: str
    port: int
    token: str = ""
    view_token: str = ""
    view_only: bool = False
    published: str = ""  # address on the host, when the panel runs in a container

    @property
    def reached_at(self) -> str:
        """Return the address at which other machines reach the panel."""
        return self.published or self.host

    def __post_init__(self) -> None:
        """Raise ForcemeshError when the panel would be open to unauthorised clients."""
        if not self.token and not is_loopback(self.reached_at):
            what = "watch the cell" if self.view_only else "move the arm"
            raise ForcemeshError(
                f"refused: on {self.reached_at} any client on the network could {what}: set "
                f"panel.token in the cell file or {TOKEN_VARIABLE}, or listen on 127.0.0.1"
            )
        for token in (self.token, self.view_token):
            if why := guessable(token):
                raise ForcemeshError(f"refused: {why}")
        if self.view_token and self.view_token == self.token:
            raise ForcemeshError(f"refused: {SAME_TOKEN}")
        if self.view_token and not self.token:
            raise ForcemeshError(
                "refused: with panel.view_token alone every client may operate: set panel.token "
                f"as well, or {TOKEN_VARIABLE}"
            )

    @property
    def is_encrypted(self) -> bool:
        """Whether the page is served by TLS: wherever other machines reach it."""
        return not is_loopback(self.reached_at)

    @property
    def cookie(self) -> str:
        """Name of the cookie, with the port: browsers share cookies among all ports of a host.

        With the prefix a browser accepts it from this host and by TLS only.
        """
        prefix = "__Host-" if self.is_encrypted else ""
        return f"{prefix}forcemesh_panel_{self.port}"

    @property
    def most(self) -> Rights:
        """Highest rights that this panel grants."""
        return "view" if self.view_only else "operate"

    def rights(self, shown: str) -> Rights | None:
        """Return the rights of a token, None for an unknown one."""
        if self.token and hmac.compare_digest(shown.encode(), self.token.encode()):
            return self.most
        is_view = hmac.compare_digest(shown.encode(), self.view_token.encode())
        return "view" if self.view_token and is_view else None

    def keep(self, number: str) -> str:
        """Return the Set-Cookie header with the number of a session."""
        kept = f"{self.cookie}={number}; Path=/; Max-Age={round(SESSION_LASTS_S)}; HttpOnly; "
        return kept + ("SameSite=Strict; Secure" if self.is_encrypted else "SameSite=Strict")

    def refusal(self, headers: Mapping[str, str]) -> str:
        """Return why a request is not from the panel's own page, empty when it is."""
        asked = headers.get("Host", "")
        name = (urlsplit(f"//{asked}").hostname or "").lower()  # without port and brackets
        if not self.token and name not in {*HERE, self.reached_at}:
            return f"unknown host name {asked!r}: open the panel at the address that it printed"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != asked.lower():
            return f"requests from pages of {origin} are refused"
        return ""


def door_of(
    section: PanelSection,
    environment: Mapping[str, str],
    *,
    host: str | None = None,
    port: int | None = None,
    view_only: bool = False,
) -> Door:
    """Return the access settings of a cell file; the arguments override them.

    Raises:
        ForcemeshError: Other machines could reach the panel and there is no token.
    """
    return Door(
        host=host or section.host,
        port=section.port if port is None else port,
        token=environment.get(TOKEN_VARIABLE) or section.token,
        view_token=section.view_token,
        view_only=view_only,
        published=environment.get(PANEL_PUBLISHED, ""),
    )


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


def context_of(cell: CellConfig, door: Door) -> ssl.SSLContext | None:
    """Return the TLS context of the panel, None when only this machine reaches it.

    Raises:
        ForcemeshError: Other machines reach it and the certificate is missing or unusable.
    """
    if not door.is_encrypted:
        return None
    folder = folder_of(cell)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(folder / f"{PAGE}.pem", folder / f"{PAGE}.key")
    except (OSError, ssl.SSLError) as error:
        what = "is missing" if isinstance(error, FileNotFoundError) else f"cannot be used ({error})"
        raise ForcemeshError(
            f"refused: on {door.reached_at} the token would be sent unencrypted, and "
            f"{folder}/{PAGE}.pem or .key {what}: run `forcemesh pki issue {PAGE} --host NAME "
            "--cell FILE` where `forcemesh pki init` was run; or let the panel listen on 127.0.0.1 "
            "and use SSH or a proxy on this machine"
        ) from None
    return context

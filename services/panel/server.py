"""HTTP and websocket server: viser behind access control, one port, one page with the status bar.

viser listens on all addresses without authentication. It passes each connection to the library
`websockets`; during its start that call is replaced: it receives a bound socket, and the gate
checks every request first. `refuse_an_open_door` is a self-test at each start, so that another
version of viser cannot bypass the check unnoticed.
"""

import contextlib
import contextvars
import errno
import http.client
import io
import json
import logging
import os
import re
import secrets
import socket
import ssl
from collections.abc import Awaitable, Callable, Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from forcemesh.clock import Clock, MonotonicClock
from forcemesh.errors import ForcemeshError
from services.panel.access import ASKED_BY_US, Door, cookie_in, token_in
from services.panel.markup import html, template
from services.panel.sessions import Rights, Sessions
from services.panel.state_colours import NO_STATE

SHOWN_TOKEN = "X-Forcemesh-Token"  # noqa: S105 - a header name: not part of addresses or logs
Reply = dict[str, Any]
Route = Callable[[Rights], Awaitable[Reply]]

RIGHTS: contextvars.ContextVar[Rights] = contextvars.ContextVar("rights", default="view")
ENTERED = '<!doctype html><meta http-equiv="refresh" content="0; url=/"><title>forcemesh</title>'
BACKLOG = 32
SELF_TEST_S = 5.0
NONCE = "nonce-of-this-answer"  # placeholder, replaced when the page is sent
# viser's front end unpacks its code, its workers and its styles from the page, and evaluates some.
POLICY = (
    "default-src 'self' data: blob:; script-src 'nonce-{nonce}' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' {sockets}data: blob:; "
    "worker-src 'self' blob: data:; frame-src 'none'; object-src 'none'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
)
UNPACKS = 'e.type="module";'  # viser's script passes its code to a script that it creates
NETLOC = re.compile(r"[A-Za-z0-9.\-]+(:[0-9]+)?|\[[0-9a-fA-F:]+\](:[0-9]+)?")


class PanelServer(viser.ViserServer):
    """viser server without the tunnel that would expose the panel to the internet."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: FBT001, FBT002 - theirs
        """Return None: sharing is disabled, as any client could request it."""
        del verbose
        return None


class Gate:
    """Request filter in front of viser; serves the page and the panel's own routes."""

    def __init__(self, door: Door, title: str, clock: Clock | None = None) -> None:
        """Read the page; no socket is opened."""
        self._door = door
        self._page = page(title)
        self._sessions, self._clock = Sessions(), clock or MonotonicClock()
        self.routes: dict[str, Route] = {}  # for requests of the panel's own page
        self.ready = False  # until then websockets are refused, also those that reconnect

    async def before(self, request: Request) -> Response | None:
        """Return the response, None to pass a websocket on to viser."""
        path = request.path.partition("?")[0]
        if path == "/alive":  # health check; needs no authentication
            return answer(HTTPStatus.OK, "alive")
        if why := self._door.refusal(request.headers):
            return answer(HTTPStatus.FORBIDDEN, why)
        is_socket = request.headers.get("Upgrade", "").lower() == "websocket"
        if self._door.token and not is_socket and (shown := token_of(request)):
            return self._enter(shown)
        rights: Rights | None = self._door.most
        if self._door.token:
            number = cookie_in(request.headers, self._door.cookie)
            rights = self._sessions.rights(number, self._clock.now_ns())
        if rights is None:
            return self._closed()
        if is_socket:
            if not self.ready:
                return answer(HTTPStatus.SERVICE_UNAVAILABLE, "starting")
            RIGHTS.set(rights)
            return None
        if path in {"/", "/index.html"}:
            asked = request.headers.get("Host", "")
            return answer(HTTPStatus.OK, self._page, "text/html", asked=asked)
        if path in self.routes and request.headers.get(ASKED_BY_US):
            page = await self.routes[path](rights)
            return answer(HTTPStatus.OK, json.dumps(page), "application/json")
        return answer(HTTPStatus.NOT_FOUND, "page not found")

    def _closed(self) -> Response:
        form = with_nonces(template("services.panel", "token.html"))
        return answer(HTTPStatus.UNAUTHORIZED, form, "text/html")

    def _enter(self, shown: str) -> Response:
        """Start a session for a valid token and remove the token from the address.

        The browser reloads the page itself: a redirect after a link in another page would lack
        the cookie, which is SameSite=Strict.
        """
        rights = self._door.rights(shown)
        if rights is None:
            return self._closed()
        number = self._sessions.begin(rights, self._clock.now_ns())
        return answer(HTTPStatus.OK, ENTERED, "text/html", Set_Cookie=self._door.keep(number))

    @contextlib.contextmanager
    def in_front(
        self, listening: socket.socket, encrypted: ssl.SSLContext | None
    ) -> Iterator[None]:
        """Make a server that is started meanwhile use this socket and this filter."""
        serve = websockets.asyncio.server.serve

        def serving(handler: Any, _host: Any, _port: Any, **options: Any) -> Any:
            async def process(_connection: ServerConnection, request: Request) -> Response | None:
                return await self.before(request)

            options |= {"process_request": process, "ssl": encrypted}
            return serve(handler, sock=listening, **options)

        websockets.asyncio.server.serve = serving  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket. Raise ForcemeshError when the port is in use."""
    try:
        return socket.create_server((host, port), backlog=BACKLOG)
    except OSError as error:
        what = "panel.host must be an address of this machine"
        if error.errno == errno.EADDRINUSE:
            what = "is another panel running? Choose another port by panel.port or --port"
        why = os.strerror(error.errno or 0)
        raise ForcemeshError(f"cannot listen on {host}:{port} ({why}): {what}") from None


def open_server(gate: Gate, door: Door, encrypted: ssl.SSLContext | None = None) -> PanelServer:
    """Start the page's server behind access control.

    Raises:
        ForcemeshError: The port is in use, or access control is not effective.
    """
    # A browser that disconnects during a request is not an error.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    listening = listen(door.host, door.port)
    with gate.in_front(listening, encrypted), contextlib.redirect_stdout(io.StringIO()):
        server = PanelServer(host=door.host, port=door.port, verbose=False)
    try:
        refuse_an_open_door(*listening.getsockname()[:2], encrypted=encrypted is not None)
    except ForcemeshError:
        close_server(server)
        raise
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop the server, without its message on standard output."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def refuse_an_open_door(host: str, port: int, *, encrypted: bool = False) -> None:
    """Self-test: send a cross-site request; raise ForcemeshError unless it is refused."""
    name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104 - not bound here
    connection = http.client.HTTPConnection(name, port, timeout=SELF_TEST_S)
    if encrypted:  # browsers verify the certificate; this tests access control only
        unverified = ssl._create_unverified_context()  # noqa: S323, SLF001
        connection = http.client.HTTPSConnection(
            name, port, timeout=SELF_TEST_S, context=unverified
        )
    try:
        connection.request("GET", "/", headers={"Origin": "http://elsewhere.example"})
        status = connection.getresponse().status
    except OSError as error:
        raise ForcemeshError(f"the panel does not answer on {host}:{port}: {error}") from None
    finally:
        connection.close()
    if status != HTTPStatus.FORBIDDEN:
        raise ForcemeshError(
            "refused: this version of viser bypasses the panel's access control; use a version "
            "that pyproject.toml names"
        )


def answer(
    status: HTTPStatus, body: str, kind: str = "text/plain", *, asked: str = "", **more: str
) -> Response:
    """Return a complete response; `asked` is the `Host` of the request for the page."""
    nonce = secrets.token_urlsafe(16)
    data = body.replace(NONCE, nonce).encode()
    headers = Headers(
        {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(data)),
            "Cache-Control": "no-store",
            "Content-Security-Policy": policy(nonce, asked),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            **{name.replace("_", "-"): value for name, value in more.items()},
        }
    )
    return Response(status.value, status.phrase, headers, data)


def token_of(request: Request) -> str:
    """Return the token of a request: from the panel's form or from the address."""
    typed: str = request.headers.get(SHOWN_TOKEN, "")
    return typed if typed and request.headers.get(ASKED_BY_US) else token_in(request.path)


def page(title: str) -> str:
    """Return viser's page with the panel's title and the status bar at its end."""
    client = Path(viser.__file__).parent / "client" / "build" / "index.html"
    text = client.read_text(encoding="utf-8").replace(
        "<title>Viser</title>", html("<title>{}</title>", title)
    )
    head, _, tail = with_nonce_unpacked(text).rpartition("</body>")
    colours = f"background: {NO_STATE.background}; color: {NO_STATE.text};"
    bar = template("services.panel", "bar.html")
    text = with_nonces(f"{head}{bar}</body>{tail}")
    return text.replace("/* colours without a state */", colours)


# --- Content-Security-Policy: its own scripts and this panel's address only -----------------------
# Second barrier behind `services.panel.markup`: if foreign text became an element, it could run,
# frame and send nothing. Every own script carries a nonce drawn for each reply; an injected script
# has none.


def policy(nonce: str, asked: str) -> str:
    """Return the header of a page with this nonce, requested under a `Host`.

    For some browsers 'self' does not include the websocket of the same address.
    """
    sockets = f"ws://{asked} wss://{asked} " if NETLOC.fullmatch(asked) else ""
    return POLICY.format(nonce=nonce, sockets=sockets)


def with_nonces(text: str) -> str:
    """Return the page with the nonce in all of its scripts."""
    return text.replace("<script", f'<script nonce="{NONCE}"')


def with_nonce_unpacked(text: str) -> str:
    """Return viser's page, changed so that its script passes the nonce to the unpacked code.

    Raises:
        ForcemeshError: This version of viser unpacks its page differently.
    """
    if text.count(UNPACKS) != 1:
        raise ForcemeshError(
            "refused: this version of viser loads its page in a form that the panel's "
            "Content-Security-Policy does not support; use a version that pyproject.toml names"
        )
    return text.replace(UNPACKS, f'{UNPACKS}e.nonce="{NONCE}";')

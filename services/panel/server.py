"""viser behind the panel's door: one port, one page with our bar in it, nothing from outside.

viser itself listens everywhere and asks nobody who he is. It hands each connection to the library
`websockets`; for the moment in which it does so, that call is ours: we give it a socket that is
bound already and let the door judge every request first. `refuse_an_open_door` proves at each start
that this took effect, so that another version of viser cannot quietly come without it.
"""

import contextlib
import contextvars
import errno
import http.client
import io
import json
import logging
import os
import secrets
import socket
import ssl
from collections.abc import Awaitable, Callable, Iterator
from http import HTTPStatus
from importlib.resources import files
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
from services.panel.markup import html
from services.panel.policy import NONCE, policy, with_nonce_unpacked, with_nonces
from services.panel.sessions import Rights, Sessions

SHOWN_TOKEN = "X-Forcemesh-Token"  # noqa: S105 - the name of a header: it is in no address and no log
Reply = dict[str, Any]
Route = Callable[[Rights], Awaitable[Reply]]
Before = Callable[[ServerConnection, Request], Response | None]

RIGHTS: contextvars.ContextVar[Rights] = contextvars.ContextVar("rights", default="view")
ENTERED = '<!doctype html><meta http-equiv="refresh" content="0; url=/"><title>forcemesh</title>'
BACKLOG = 32
SELF_TEST_S = 5.0


class PanelServer(viser.ViserServer):
    """viser without the tunnel that would show the panel to the internet."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: FBT001, FBT002 - theirs
        """Never share: any client may ask for it."""
        del verbose
        return None


class Gate:
    """Answers what is not viser's own, and judges all before viser sees it."""

    def __init__(self, door: Door, title: str, clock: Clock | None = None) -> None:
        """Read the page once; nothing is listened to yet."""
        self._door = door
        self._page = page(title)
        self._sessions, self._clock = Sessions(), clock or MonotonicClock()
        self.routes: dict[str, Route] = {}  # what only our own page asks
        self.alive: Callable[[], bool] = lambda: True
        self.ready = False  # until then a page that waits to come back must wait

    async def before(self, request: Request) -> Response | None:
        """Return the answer, None to let viser go on with its websocket."""
        path = request.path.partition("?")[0]
        if path == "/alive":  # says nothing to anybody but that it works
            alive = self.alive()
            status = HTTPStatus.OK if alive else HTTPStatus.SERVICE_UNAVAILABLE
            return answer(status, "alive" if alive else "the cell is not heard", "text/plain")
        if why := self._door.stranger(request.headers):
            return answer(HTTPStatus.FORBIDDEN, why, "text/plain")
        is_socket = request.headers.get("Upgrade", "").lower() == "websocket"
        if self._door.token and not is_socket and (shown := token_of(request)):
            return self._enter(shown)
        rights = self._rights(request)
        if rights is None:
            return self._closed()
        if is_socket:
            if not self.ready:
                return answer(HTTPStatus.SERVICE_UNAVAILABLE, "in a moment", "text/plain")
            RIGHTS.set(rights)
            return None
        if path in {"/", "/index.html"}:
            asked = request.headers.get("Host", "")
            return answer(HTTPStatus.OK, self._page, "text/html", asked=asked)
        if path in self.routes and request.headers.get(ASKED_BY_US):
            said = await self.routes[path](rights)
            return answer(HTTPStatus.OK, json.dumps(said), "application/json")
        return answer(HTTPStatus.NOT_FOUND, "there is no such page", "text/plain")

    def _rights(self, request: Request) -> Rights | None:
        """Return what whoever asks may do: without a token all, else as the session says."""
        if not self._door.token:
            return self._door.most
        number = cookie_in(request.headers, self._door.cookie)
        return self._sessions.rights(number, self._clock.now_ns())

    def _closed(self) -> Response:
        return answer(HTTPStatus.UNAUTHORIZED, with_nonces(resource("token.html")), "text/html")

    def _enter(self, shown: str) -> Response:
        """Begin a session for a good token, which then stands in no address that people copy.

        The browser loads the page by itself: a redirect from a link in another page would come
        without the cookie, which is for this panel's own pages alone.
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
        """Let the server that is started meanwhile use this socket and ask us first."""
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
    """Return a socket that listens. Raise ForcemeshError when somebody else has the port."""
    try:
        return socket.create_server((host, port), backlog=BACKLOG)
    except OSError as error:
        what = "panel.host is to be an address of this machine"
        if error.errno == errno.EADDRINUSE:
            what = "is the panel there already? panel.port, or --port, chooses another one"
        why = os.strerror(error.errno or 0)
        raise ForcemeshError(f"cannot listen on {host}:{port} ({why}): {what}") from None


def open_server(gate: Gate, door: Door, encrypted: ssl.SSLContext | None = None) -> PanelServer:
    """Start the page's server behind the door.

    Raises:
        ForcemeshError: The port is taken, or the door did not take effect.
    """
    # A browser that goes away in the middle of a request is no news.
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
    """Stop it, without its word on standard output."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def refuse_an_open_door(host: str, port: int, *, encrypted: bool = False) -> None:
    """Come as a page of somebody else would; whoever is let in has found no door."""
    name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104 - not bound here
    asking = http.client.HTTPConnection(name, port, timeout=SELF_TEST_S)
    if encrypted:  # whose certificate it is, is for browsers to judge: this is the door alone
        unverified = ssl._create_unverified_context()  # noqa: S323, SLF001
        asking = http.client.HTTPSConnection(name, port, timeout=SELF_TEST_S, context=unverified)
    try:
        asking.request("GET", "/", headers={"Origin": "http://stranger.example"})
        status = asking.getresponse().status
    except OSError as error:
        raise ForcemeshError(f"the panel does not answer on {host}:{port}: {error}") from None
    finally:
        asking.close()
    if status != HTTPStatus.FORBIDDEN:
        raise ForcemeshError(
            "refused: this version of viser goes round the panel's door; use one that "
            "pyproject.toml names"
        )


def answer(status: HTTPStatus, body: str, kind: str, *, asked: str = "", **more: str) -> Response:
    """Return a whole answer; `asked` is the `Host` under which the page was asked for."""
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
        }
    )
    for name, value in more.items():
        headers[name.replace("_", "-")] = value
    return Response(status.value, status.phrase, headers, data)


def token_of(request: Request) -> str:
    """Return the token that is shown: typed into our own form, or in an address that was given."""
    typed: str = request.headers.get(SHOWN_TOKEN, "")
    return typed if typed and request.headers.get(ASKED_BY_US) else token_in(request.path)


def page(title: str) -> str:
    """Return viser's page with our title, and our bar at its end."""
    client = Path(viser.__file__).parent / "client" / "build" / "index.html"
    text = client.read_text(encoding="utf-8").replace(
        "<title>Viser</title>", html("<title>{}</title>", title).source
    )
    head, _, tail = with_nonce_unpacked(text).rpartition("</body>")
    return with_nonces(f"{head}{resource('bar.html')}</body>{tail}")


def resource(name: str) -> str:
    """Return a file that lies beside this one."""
    return files("services.panel").joinpath(name).read_text(encoding="utf-8")

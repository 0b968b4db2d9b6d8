"""Who may open the panel, and what nobody may."""

import asyncio
import http.client
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.datastructures import Headers
from websockets.http11 import Request
from websockets.sync.client import connect
from websockets.typing import Origin

from common.cell_panel import PanelSection
from common.config import load_cell
from common.errors import ConfigError, ForcemeshError
from services.panel.door import Door, door_of, stays_here
from services.panel.server import Gate, PanelServer, close_server, listen, open_server

TOKEN, VIEW = "0123456789abcdef", "fedcba9876543210"
HERE = {"Host": "127.0.0.1:8080"}
WIDE = "0.0.0.0"


def door(**more):
    """Return a door on this machine."""
    return Door(**{"host": "127.0.0.1", "port": 8080, **more})


def asked(gate: Gate, path: str = "/", **headers: str):
    """Return what the gate answers, None where it lets viser go on."""
    names = {
        name.replace("_", "-"): value for name, value in ({"Host": HERE["Host"]} | headers).items()
    }
    return asyncio.run(gate.before(Request(path, Headers(names))))


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.7", "labpc", ""])
def test_wider_than_this_machine_needs_a_token(host):
    """Without one it is refused in one sentence that says how; with one it is not."""
    assert not stays_here(host)
    with pytest.raises(ForcemeshError, match=r"refused: .* panel\.token .* 127\.0\.0\.1"):
        Door(host, 8080)
    assert Door(host, 8080, token=TOKEN).rights("/", {}) is None


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost"])
def test_this_machine_needs_none(host):
    """Who sits at the machine may operate."""
    assert Door(host, 8080).rights("/", {}) == "operate"


def test_a_token_that_can_be_guessed_is_refused():
    """Short ones are none."""
    with pytest.raises(ForcemeshError, match="can be guessed"):
        Door(WIDE, 8080, token="0" * 15)


@pytest.mark.parametrize("more", [{}, {"token": VIEW}])
def test_who_may_only_look_never_operates(more):
    """A view token alone, or one that is the operator's too, would let everybody operate."""
    with pytest.raises(ForcemeshError, match=r"everybody may operate|could operate"):
        Door("127.0.0.1", 8080, view_token=VIEW, **more)


@pytest.mark.parametrize("panel", [{"token": "short"}, {"token": VIEW, "view_token": VIEW}])
def test_the_cell_file_is_told_what_the_panel_would_refuse(panel):
    """`config check` says it, before anything is started."""
    with pytest.raises(ConfigError, match=r"can be guessed|could operate"):
        load_cell(Path(__file__).parents[2] / "cells" / "demo.yaml", {"panel": panel})


@given(st.text(max_size=40))
def test_only_the_token_itself_opens(shown):
    """Whatever else is shown, in the address or as a cookie, opens nothing and breaks nothing."""
    locked = Door(WIDE, 8080, token=TOKEN, view_token=VIEW)
    expected = {TOKEN: "operate", VIEW: "view"}.get(shown)
    cookie = {"Cookie": f"{locked.cookie}={shown}"}
    if shown.isalnum() and shown.isascii():
        assert locked.rights(f"/?token={shown}", {}) == expected
        assert locked.rights("/", cookie) == expected
    else:
        assert locked.rights("/", cookie) is None


def test_view_only_gives_nobody_more():
    """The word on the command line goes before every token."""
    locked = Door(WIDE, 8080, token=TOKEN, view_token=VIEW, view_only=True)
    assert locked.rights(f"/?token={TOKEN}", {}) == "view"
    assert door(view_only=True).rights("/", HERE) == "view"


@pytest.mark.parametrize(
    ("headers", "stranger"),
    [
        ({"Host": "127.0.0.1:8080"}, False),
        ({"Host": "localhost:9999"}, False),  # a tunnel
        ({"Host": "[::1]:8080"}, False),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8080"}, False),
        ({"Host": "evil.example"}, True),  # a name that was bent to this machine
        ({"Host": "127.0.0.1.evil.example:8080"}, True),
        ({"Host": ""}, True),
        ({}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://evil.example"}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8081"}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "null"}, True),
    ],
)
def test_pages_of_others_are_told_from_our_own(headers, stranger):
    """A page of the internet cannot use a browser on this machine to move the arm."""
    assert bool(door().stranger(headers)) is stranger


def test_the_environment_goes_before_the_cell_file_and_the_command_line_before_both():
    """Three places may say it."""
    section = PanelSection(host="127.0.0.1", port=8081, token="a" * 16)
    found = door_of(section, {"FORCEMESH_PANEL_TOKEN": TOKEN}, host=WIDE, port=9000)
    assert (found.host, found.port, found.token) == (WIDE, 9000, TOKEN)
    found = door_of(section, {})
    assert (found.host, found.port, found.token) == ("127.0.0.1", 8081, "a" * 16)


def test_the_gate_answers_only_what_it_should():
    """Page, bar and health have answers; strangers, other pages and no token have none."""
    gate = Gate(door(), "cell")
    gate.routes = {"/stop": _said}
    assert asked(gate).status_code == 200
    assert b"Stop motion" in asked(gate).body
    assert asked(gate, "/alive", Host="anything").status_code == 200
    assert asked(gate, Origin="http://evil.example").status_code == 403
    assert asked(gate, "/nothing").status_code == 404
    assert asked(gate, "/stop").status_code == 404  # a picture of another page could ask so much
    assert json.loads(asked(gate, "/stop", X_Forcemesh="1").body) == {"rights": "operate"}
    locked = Gate(Door(WIDE, 8080, token=TOKEN), "cell")
    assert asked(locked).status_code == 401
    assert asked(locked, "/stop", X_Forcemesh="1").status_code == 401
    taken = asked(locked, f"/?token={TOKEN}")
    assert (taken.status_code, taken.headers["Location"]) == (303, "/")
    assert "HttpOnly; SameSite=Lax" in taken.headers["Set-Cookie"]


async def _said(rights):
    return {"rights": rights}


def test_the_page_may_call_nobody_else():
    """The browser itself is told to keep the page from asking anybody outside."""
    policy = asked(Gate(door(), "cell")).headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "http" not in policy


@pytest.mark.realtime
def test_viser_is_behind_the_door():
    """On real sockets: strangers get neither page nor websocket, who may gets both."""
    free = listen("127.0.0.1", 0)
    port = free.getsockname()[1]
    free.close()
    here = Door("127.0.0.1", port)
    gate = Gate(here, "cell")
    server = open_server(gate, here)
    try:
        for headers, expected in (({}, 200), ({"Origin": "http://evil.example"}, 403)):
            asking = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
            asking.request("GET", "/", headers=headers)
            assert asking.getresponse().status == expected
            asking.close()
        url, ours = f"ws://127.0.0.1:{port}", Origin(f"http://127.0.0.1:{port}")
        with pytest.raises(Exception, match="503"):
            connect(url, origin=ours, proxy=None)
        gate.ready = True
        with pytest.raises(Exception, match="403"):
            connect(url, origin=Origin("http://evil.example"), proxy=None)
        connect(url, origin=ours, proxy=None).close()
        with pytest.raises(ForcemeshError, match="cannot listen"):
            listen("127.0.0.1", port)
    finally:
        close_server(server)


def test_a_viser_that_goes_round_the_door_is_not_served(monkeypatch):
    """The proof at the start finds out, and nothing stays open."""
    monkeypatch.setattr(Gate, "before", lambda self, request: _nobody_is_asked())
    here = Door("127.0.0.1", 18999)
    with pytest.raises(ForcemeshError, match=r"goes round the panel's door|does not answer"):
        open_server(Gate(here, "cell"), here)


async def _nobody_is_asked():
    return None


def test_nothing_is_ever_shared_with_the_internet():
    """Viser's tunnel, which any client may ask for, is not there."""
    assert PanelServer.request_share_url(object.__new__(PanelServer)) is None

"""Who may open the panel, and what nobody may."""

import asyncio
import http.client
import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.datastructures import Headers
from websockets.http11 import Request
from websockets.sync.client import connect
from websockets.typing import Origin

from common.config.cell_panel import PanelSection
from common.config.load import load_cell
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import ConfigError, ForcemeshError
from forcemesh.published_ports import is_loopback
from services.panel.access import Door, door_of
from services.panel.policy import with_nonce_unpacked
from services.panel.server import Gate, PanelServer, close_server, listen, open_server
from services.panel.sessions import SESSION_IDLE_S

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
    assert not is_loopback(host)
    with pytest.raises(ForcemeshError, match=r"refused: .* panel\.token .* 127\.0\.0\.1"):
        Door(host, 8080)
    assert Door(host, 8080, token=TOKEN).rights("") is None


def test_in_a_container_the_published_address_is_judged():
    """There it listens on every address; who reaches it is decided by what compose publishes."""
    section = PanelSection()
    here = door_of(section, {"FORCEMESH_PANEL_PUBLISHED": "127.0.0.1"}, host=WIDE)
    assert asked(Gate(here, "cell")).status_code == 200
    assert not here.stranger({"Host": "127.0.0.1:8080"})
    assert here.stranger({"Host": "evil.example:8080"})
    for wider in (WIDE, "192.168.1.7", ""):
        with pytest.raises(ForcemeshError, match=r"refused: on .* panel\.token"):
            door_of(section, {"FORCEMESH_PANEL_PUBLISHED": wider}, host=WIDE)
        both = {"FORCEMESH_PANEL_PUBLISHED": wider, "FORCEMESH_PANEL_TOKEN": TOKEN}
        assert asked(Gate(door_of(section, both, host=WIDE), "cell")).status_code == 401


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost"])
def test_this_machine_needs_none(host):
    """Who sits at the machine may operate."""
    assert Door(host, 8080).most == "operate"
    assert asked(Gate(Door(host, 8080), "cell")).status_code == 200


def test_a_token_that_can_be_guessed_is_refused():
    """Short ones are none."""
    with pytest.raises(ForcemeshError, match="can be guessed"):
        Door(WIDE, 8080, token="0" * 15)


@pytest.mark.parametrize("more", [{}, {"token": VIEW}])
def test_who_may_only_look_never_operates(more):
    """A view token alone, or one that is the operator's too, would let everybody operate."""
    with pytest.raises(ForcemeshError, match=r"every client may operate|could operate"):
        Door("127.0.0.1", 8080, view_token=VIEW, **more)


@pytest.mark.parametrize("panel", [{"token": "short"}, {"token": VIEW, "view_token": VIEW}])
def test_the_cell_file_is_told_what_the_panel_would_refuse(panel):
    """`config check` says it, before anything is started."""
    with pytest.raises(ConfigError, match=r"can be guessed|could operate"):
        load_cell(Path(__file__).parents[4] / "cells" / "demo.yaml", {"panel": panel})


@given(st.text(max_size=40))
def test_only_the_token_itself_opens(shown):
    """Whatever else is shown opens nothing and breaks nothing; a cookie is never a token."""
    locked = Door(WIDE, 8080, token=TOKEN, view_token=VIEW)
    assert locked.rights(shown) is None
    assert locked.rights(TOKEN) == "operate"
    assert locked.rights(VIEW) == "view"
    assert Door("127.0.0.1", 8080).rights(shown) is None


def test_view_only_gives_nobody_more():
    """The word on the command line goes before every token."""
    locked = Door(WIDE, 8080, token=TOKEN, view_token=VIEW, view_only=True)
    assert locked.rights(TOKEN) == "view"
    assert door(view_only=True).most == "view"


def session_of(response) -> str:
    """Return the cookie that a browser sends from now on."""
    return response.headers["Set-Cookie"].partition(";")[0]


@pytest.mark.parametrize("way", ["address", "form"])
def test_a_token_begins_a_session_and_is_not_kept_in_the_browser(way):
    """The cookie holds a random number, sent by this panel's own pages alone."""
    gate = Gate(Door(WIDE, 8080, token=TOKEN, view_token=VIEW), "cell")
    gate.routes = {"/stop": _said}
    for token, rights in ((TOKEN, "operate"), (VIEW, "view")):
        if way == "address":
            entered = asked(gate, f"/?token={token}")
            assert b'http-equiv="refresh" content="0; url=/"' in entered.body
        else:
            entered = asked(gate, "/", X_Forcemesh="1", X_Forcemesh_Token=token)
        assert entered.status_code == 200
        kept = entered.headers["Set-Cookie"]
        assert token not in kept
        assert "HttpOnly; SameSite=Strict" in kept
        said = asked(gate, "/stop", X_Forcemesh="1", Cookie=session_of(entered))
        assert json.loads(said.body) == {"rights": rights}
    name = Door(WIDE, 8080, token=TOKEN).cookie
    for cookie in (f"{name}={TOKEN}", f"{name}=", f"{name}={'A' * 43}", "x=y"):
        assert asked(gate, Cookie=cookie).status_code == 401
    assert asked(gate, "/?token=wrong").status_code == 401
    assert asked(gate, "/", X_Forcemesh_Token=TOKEN).status_code == 401  # not of our own form


def test_a_session_ends_and_the_page_asks_for_the_token_again():
    """By age; and each panel has sessions of its own, which end with it."""
    clock = ManualClock()
    gate = Gate(Door(WIDE, 8080, token=TOKEN), "cell", clock)
    cookie = session_of(asked(gate, f"/?token={TOKEN}"))
    assert asked(gate, Cookie=cookie).status_code == 200
    clock.advance_ns(round(SESSION_IDLE_S * NS_PER_S))
    assert asked(gate, Cookie=cookie).status_code == 401
    other = Gate(Door(WIDE, 8080, token=TOKEN), "cell")
    assert asked(other, Cookie=cookie).status_code == 401


def test_a_websocket_needs_a_session_and_takes_no_token():
    """A page opens it with its cookie; an address with a token in it stands in logs."""
    gate = Gate(Door(WIDE, 8080, token=TOKEN), "cell")
    gate.ready = True
    cookie = session_of(asked(gate, f"/?token={TOKEN}"))
    assert asked(gate, f"/?token={TOKEN}", Upgrade="websocket").status_code == 401
    assert asked(gate, Upgrade="websocket", Cookie=cookie) is None


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
    assert asked(locked, f"/?token={TOKEN}", Origin="http://evil.example").status_code == 403


async def _said(rights):
    return {"rights": rights}


def test_the_page_may_call_nobody_else():
    """The browser itself is told to keep the page from asking anybody outside."""
    policy = asked(Gate(door(), "cell")).headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy
    for what in ("frame-src", "object-src", "frame-ancestors", "base-uri"):
        assert f"{what} 'none'" in policy
    assert "http" not in policy
    assert policy.count("ws:") == policy.count(f"ws://{HERE['Host']}") == 1
    bent = asked(Gate(locked_door(), "cell"), f"/?token={TOKEN}", Host="x; script-src *")
    assert "script-src *" not in bent.headers["Content-Security-Policy"]


def test_only_our_own_scripts_run():
    """Each answer has a number of its own, which all of its scripts carry."""
    gate = Gate(door(), "<b>cell</b>")
    seen = set()
    for _ in range(3):
        page = asked(gate)
        policy = page.headers["Content-Security-Policy"]
        (nonce,) = re.findall(r"script-src 'nonce-([A-Za-z0-9_-]{20,})'", policy)
        seen.add(nonce)
        assert "unsafe-inline" not in policy.partition("script-src")[2].partition(";")[0]
        body = page.body.decode()
        assert body.count("<script") == body.count(f'<script nonce="{nonce}"') >= 2
        assert f'e.nonce="{nonce}"' in body
        assert "<title>&lt;b&gt;cell" in body
    assert len(seen) == 3


def test_a_viser_that_starts_its_page_in_another_way_is_refused():
    """The rule would keep its page white; that is said at the start."""
    with pytest.raises(ForcemeshError, match=r"refused: .*Content-Security-Policy"):
        with_nonce_unpacked("<script>start()</script>")


def locked_door():
    """Return a door that others reach."""
    return Door(WIDE, 8080, token=TOKEN, view_token=VIEW)


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
    with pytest.raises(ForcemeshError, match=r"bypasses the panel's access|does not answer"):
        open_server(Gate(here, "cell"), here)


async def _nobody_is_asked():
    return None


def test_nothing_is_ever_shared_with_the_internet():
    """Viser's tunnel, which any client may ask for, is not there."""
    assert PanelServer.request_share_url(object.__new__(PanelServer)) is None

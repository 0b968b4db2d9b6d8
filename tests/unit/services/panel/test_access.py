"""Access to the panel: tokens, sessions, origins, and requests that are refused."""

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

from common.config.cell_helpers import PanelSection
from common.config.load import load_cell
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import ConfigError, ForcemeshError
from forcemesh.published_ports import is_loopback
from services.panel.access import Door, door_of
from services.panel.server import (
    Gate,
    PanelServer,
    close_server,
    listen,
    open_server,
    with_nonce_unpacked,
)
from services.panel.sessions import SESSION_IDLE_S

TOKEN, VIEW = "0123456789abcdef", "fedcba9876543210"
HERE = {"Host": "127.0.0.1:8080"}
WIDE = "0.0.0.0"


def door(**more):
    """Return a door on this machine."""
    return Door(**{"host": "127.0.0.1", "port": 8080, **more})


def answer_of(gate: Gate, path: str = "/", **headers: str):
    """Return the gate's answer, None where viser may continue."""
    names = {
        name.replace("_", "-"): value for name, value in ({"Host": HERE["Host"]} | headers).items()
    }
    return asyncio.run(gate.before(Request(path, Headers(names))))


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.7", "labpc", ""])
def test_wider_than_this_machine_needs_a_token(host):
    """Without one it is refused in one sentence with the remedy; with one it is accepted."""
    assert not is_loopback(host)
    with pytest.raises(ForcemeshError, match=r"refused: .* panel\.token .* 127\.0\.0\.1"):
        Door(host, 8080)
    assert Door(host, 8080, token=TOKEN).rights("") is None


def test_in_a_container_the_published_address_is_checked():
    """The process listens on every address there; compose's published address decides."""
    section = PanelSection()
    local = door_of(section, {"FORCEMESH_PANEL_PUBLISHED": "127.0.0.1"}, host=WIDE)
    assert answer_of(Gate(local, "cell")).status_code == 200
    assert not local.refusal({"Host": "127.0.0.1:8080"})
    assert local.refusal({"Host": "other.example:8080"})
    for wider in (WIDE, "192.168.1.7", ""):
        with pytest.raises(ForcemeshError, match=r"refused: on .* panel\.token"):
            door_of(section, {"FORCEMESH_PANEL_PUBLISHED": wider}, host=WIDE)
        both = {"FORCEMESH_PANEL_PUBLISHED": wider, "FORCEMESH_PANEL_TOKEN": TOKEN}
        assert answer_of(Gate(door_of(section, both, host=WIDE), "cell")).status_code == 401


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost"])
def test_this_machine_needs_no_token(host):
    """A local user may operate."""
    assert Door(host, 8080).most == "operate"
    assert answer_of(Gate(Door(host, 8080), "cell")).status_code == 200


def test_a_token_that_can_be_guessed_is_refused():
    """Short tokens are refused."""
    with pytest.raises(ForcemeshError, match="can be guessed"):
        Door(WIDE, 8080, token="0" * 15)


@pytest.mark.parametrize("more", [{}, {"token": VIEW}])
def test_a_view_token_alone_is_refused(more):
    """Alone, or equal to the operator's token, it would let every client operate."""
    with pytest.raises(ForcemeshError, match=r"every client may operate|could operate"):
        Door("127.0.0.1", 8080, view_token=VIEW, **more)


@pytest.mark.parametrize("panel", [{"token": "short"}, {"token": VIEW, "view_token": VIEW}])
def test_the_check_of_the_cell_file_reports_the_panels_refusals(panel):
    """`config check` reports them before a start."""
    with pytest.raises(ConfigError, match=r"can be guessed|could operate"):
        load_cell(Path(__file__).parents[4] / "cells" / "demo.yaml", {"panel": panel})


@given(st.text(max_size=40))
def test_only_the_token_itself_gives_access(offered):
    """Any other text gives no access and no error; a cookie is never a token."""
    locked = Door(WIDE, 8080, token=TOKEN, view_token=VIEW)
    assert locked.rights(offered) is None
    assert locked.rights(TOKEN) == "operate"
    assert locked.rights(VIEW) == "view"
    assert Door("127.0.0.1", 8080).rights(offered) is None


def test_view_only_limits_every_token():
    """The option of the command line takes precedence over the tokens."""
    locked = Door(WIDE, 8080, token=TOKEN, view_token=VIEW, view_only=True)
    assert locked.rights(TOKEN) == "view"
    assert door(view_only=True).most == "view"


def session_of(response) -> str:
    """Return the cookie that a browser sends from now on."""
    return response.headers["Set-Cookie"].partition(";")[0]


@pytest.mark.parametrize("entry", ["address", "form"])
def test_a_token_begins_a_session_and_is_not_kept_in_the_browser(entry):
    """The cookie has a random number, and only this panel's own pages send it."""
    gate = Gate(Door(WIDE, 8080, token=TOKEN, view_token=VIEW), "cell")
    gate.routes = {"/stop": _rights_answer}
    for token, rights in ((TOKEN, "operate"), (VIEW, "view")):
        if entry == "address":
            entered = answer_of(gate, f"/?token={token}")
            assert b'http-equiv="refresh" content="0; url=/"' in entered.body
        else:
            entered = answer_of(gate, "/", X_Forcemesh="1", X_Forcemesh_Token=token)
        assert entered.status_code == 200
        kept = entered.headers["Set-Cookie"]
        assert token not in kept
        assert "HttpOnly; SameSite=Strict" in kept
        answer = answer_of(gate, "/stop", X_Forcemesh="1", Cookie=session_of(entered))
        assert json.loads(answer.body) == {"rights": rights}
    name = Door(WIDE, 8080, token=TOKEN).cookie
    for cookie in (f"{name}={TOKEN}", f"{name}=", f"{name}={'A' * 43}", "x=y"):
        assert answer_of(gate, Cookie=cookie).status_code == 401
    assert answer_of(gate, "/?token=wrong").status_code == 401
    assert (
        answer_of(gate, "/", X_Forcemesh_Token=TOKEN).status_code == 401
    )  # not from the panel's own form


def test_a_session_ends_and_the_page_requires_the_token_again():
    """It ends by age; each panel has its own sessions, which end with it."""
    clock = ManualClock()
    gate = Gate(Door(WIDE, 8080, token=TOKEN), "cell", clock)
    cookie = session_of(answer_of(gate, f"/?token={TOKEN}"))
    assert answer_of(gate, Cookie=cookie).status_code == 200
    clock.advance_ns(round(SESSION_IDLE_S * NS_PER_S))
    assert answer_of(gate, Cookie=cookie).status_code == 401
    other = Gate(Door(WIDE, 8080, token=TOKEN), "cell")
    assert answer_of(other, Cookie=cookie).status_code == 401


def test_a_websocket_needs_a_session_and_takes_no_token():
    """A page opens it with its cookie; an address with a token would be logged."""
    gate = Gate(Door(WIDE, 8080, token=TOKEN), "cell")
    gate.ready = True
    cookie = session_of(answer_of(gate, f"/?token={TOKEN}"))
    assert answer_of(gate, f"/?token={TOKEN}", Upgrade="websocket").status_code == 401
    assert answer_of(gate, Upgrade="websocket", Cookie=cookie) is None


@pytest.mark.parametrize(
    ("headers", "is_foreign"),
    [
        ({"Host": "127.0.0.1:8080"}, False),
        ({"Host": "localhost:9999"}, False),  # a tunnel
        ({"Host": "[::1]:8080"}, False),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8080"}, False),
        ({"Host": "other.example"}, True),  # a name that was rebound to this machine
        ({"Host": "127.0.0.1.other.example:8080"}, True),
        ({"Host": ""}, True),
        ({}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://other.example"}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8081"}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "null"}, True),
    ],
)
def test_foreign_pages_are_distinguished_from_the_panels(headers, is_foreign):
    """A page of the internet cannot use a local browser to move the arm."""
    assert bool(door().refusal(headers)) is is_foreign


def test_the_command_line_precedes_the_environment_and_both_the_cell_file():
    """Each of the three sources may have the address and the token."""
    section = PanelSection(host="127.0.0.1", port=8081, token="a" * 16)
    found = door_of(section, {"FORCEMESH_PANEL_TOKEN": TOKEN}, host=WIDE, port=9000)
    assert (found.host, found.port, found.token) == (WIDE, 9000, TOKEN)
    found = door_of(section, {})
    assert (found.host, found.port, found.token) == ("127.0.0.1", 8081, "a" * 16)


def test_the_gate_answers_permitted_requests_only():
    """Page, bar and health have answers; foreign hosts, other pages, no token have none."""
    gate = Gate(door(), "cell")
    gate.routes = {"/stop": _rights_answer}
    assert answer_of(gate).status_code == 200
    assert b"Stop motion" in answer_of(gate).body
    assert answer_of(gate, "/alive", Host="anything").status_code == 200
    assert answer_of(gate, Origin="http://other.example").status_code == 403
    assert answer_of(gate, "/nothing").status_code == 404
    assert (
        answer_of(gate, "/stop").status_code == 404
    )  # an image of another page could request this
    assert json.loads(answer_of(gate, "/stop", X_Forcemesh="1").body) == {"rights": "operate"}
    locked = Gate(Door(WIDE, 8080, token=TOKEN), "cell")
    assert answer_of(locked).status_code == 401
    assert answer_of(locked, "/stop", X_Forcemesh="1").status_code == 401
    assert answer_of(locked, f"/?token={TOKEN}", Origin="http://other.example").status_code == 403


async def _rights_answer(rights):
    return {"rights": rights}


def test_the_page_may_call_no_other_host():
    """The content security policy lets the browser call this host only."""
    policy = answer_of(Gate(door(), "cell")).headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy
    for directive in ("frame-src", "object-src", "frame-ancestors", "base-uri"):
        assert f"{directive} 'none'" in policy
    assert "http" not in policy
    assert policy.count("ws:") == policy.count(f"ws://{HERE['Host']}") == 1
    injected = answer_of(Gate(locked_door(), "cell"), f"/?token={TOKEN}", Host="x; script-src *")
    assert "script-src *" not in injected.headers["Content-Security-Policy"]


def test_only_the_panels_own_scripts_run():
    """Each answer has a new number, which all of its scripts have."""
    gate = Gate(door(), "<b>cell</b>")
    nonces = set()
    for _ in range(3):
        page = answer_of(gate)
        policy = page.headers["Content-Security-Policy"]
        (nonce,) = re.findall(r"script-src 'nonce-([A-Za-z0-9_-]{20,})'", policy)
        nonces.add(nonce)
        assert "unsafe-inline" not in policy.partition("script-src")[2].partition(";")[0]
        body = page.body.decode()
        assert body.count("<script") == body.count(f'<script nonce="{nonce}"') >= 2
        assert f'e.nonce="{nonce}"' in body
        assert "<title>&lt;b&gt;cell" in body
    assert len(nonces) == 3


def test_a_viser_with_another_start_of_its_page_is_refused():
    """The policy would leave its page empty; the error comes at the start."""
    with pytest.raises(ForcemeshError, match=r"refused: .*Content-Security-Policy"):
        with_nonce_unpacked("<script>start()</script>")


def locked_door():
    """Return a door that other hosts reach."""
    return Door(WIDE, 8080, token=TOKEN, view_token=VIEW)


@pytest.mark.realtime
def test_viser_is_behind_the_door():
    """On real sockets foreign requests get neither page nor websocket, permitted ones get both."""
    free = listen("127.0.0.1", 0)
    port = free.getsockname()[1]
    free.close()
    local = Door("127.0.0.1", port)
    gate = Gate(local, "cell")
    server = open_server(gate, local)
    try:
        for headers, expected in (({}, 200), ({"Origin": "http://other.example"}, 403)):
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
            connection.request("GET", "/", headers=headers)
            assert connection.getresponse().status == expected
            connection.close()
        url, ours = f"ws://127.0.0.1:{port}", Origin(f"http://127.0.0.1:{port}")
        with pytest.raises(Exception, match="503"):
            connect(url, origin=ours, proxy=None)
        gate.ready = True
        with pytest.raises(Exception, match="403"):
            connect(url, origin=Origin("http://other.example"), proxy=None)
        connect(url, origin=ours, proxy=None).close()
        with pytest.raises(ForcemeshError, match="cannot listen"):
            listen("127.0.0.1", port)
    finally:
        close_server(server)


def test_a_viser_that_bypasses_the_door_is_not_served(monkeypatch):
    """The check at the start detects it, and no socket stays open."""
    monkeypatch.setattr(Gate, "before", lambda self, request: _let_pass())
    local = Door("127.0.0.1", 18999)
    with pytest.raises(ForcemeshError, match=r"bypasses the panel's access|does not answer"):
        open_server(Gate(local, "cell"), local)


async def _let_pass():
    return None


def test_nothing_is_shared_with_the_internet():
    """Viser's tunnel, which any client may request, is switched off."""
    assert PanelServer.request_share_url(object.__new__(PanelServer)) is None

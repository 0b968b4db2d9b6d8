"""Access to the panel: doors, tokens, sessions, foreign pages, and the policy of the page."""

import asyncio
import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.datastructures import Headers
from websockets.http11 import Request

from common.config.cell_helpers import PanelSection
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import ForcemeshError
from services.panel.access import Door, door_of
from services.panel.server import Gate, PanelServer, listen, open_server, with_nonce_unpacked
from services.panel.sessions import SESSION_IDLE_S
from tests.chaos.common_net import free_port

TOKEN, VIEW = "0123456789abcdef", "fedcba9876543210"
HERE = "127.0.0.1:8080"
WIDE = "0.0.0.0"
LOCAL = Door("127.0.0.1", 8080)
LOCKED = Door(WIDE, 8080, token=TOKEN, view_token=VIEW)


async def rights_answer(rights):
    """Answer a request with the rights that it has."""
    return {"rights": rights}


def gate_of(door: Door, title: str = "cell", clock: ManualClock | None = None) -> Gate:
    """Return a gate with one route."""
    gate = Gate(door, title, clock)
    gate.routes = {"/stop": rights_answer}
    return gate


def answer_of(gate: Gate, path: str = "/", **headers: str):
    """Return the gate's answer, None where viser may continue."""
    names = {name.replace("_", "-"): value for name, value in ({"Host": HERE} | headers).items()}
    return asyncio.run(gate.before(Request(path, Headers(names))))


# --- doors ----------------------------------------------------------------------------------------

UNLOCKED = r"refused: on .* panel\.token .* 127\.0\.0\.1"


@pytest.mark.parametrize(
    ("section", "published", "refused"),
    [
        *(({"host": host}, None, "") for host in ("127.0.0.1", "127.8.8.8", "::1", "localhost")),
        *(({"host": host}, None, UNLOCKED) for host in (WIDE, "::", "192.168.0.7", "labpc")),
        ({"host": WIDE, "token": TOKEN}, None, ""),
        ({"host": WIDE}, "127.0.0.1", ""),  # in a container the published address decides
        ({"host": WIDE}, "192.168.1.7", UNLOCKED),
        ({"host": WIDE, "token": TOKEN}, "192.168.1.7", ""),
        ({"host": WIDE, "token": "0" * 15}, None, "can be guessed"),
        ({"view_token": VIEW}, None, "every client may operate"),
        ({"token": VIEW, "view_token": VIEW}, None, "could operate"),
    ],
)
def test_a_door_that_other_machines_reach_needs_a_token(section, published, refused):
    """On this machine any user may operate; elsewhere there is a token that cannot be guessed."""
    environment = {} if published is None else {"FORCEMESH_PANEL_PUBLISHED": published}
    made = PanelSection.model_construct(**(PanelSection().model_dump() | section))
    if refused:
        with pytest.raises(ForcemeshError, match=refused):
            door_of(made, environment)
        return
    status = answer_of(gate_of(door_of(made, environment))).status_code
    assert status == (401 if "token" in section else 200)


@given(st.text(max_size=40))
def test_only_the_token_itself_gives_access(offered):
    """Any other text gives no access and no error; --view-only limits every token."""
    assert LOCKED.rights(offered) is LOCAL.rights(offered) is None
    assert (LOCKED.rights(TOKEN), LOCKED.rights(VIEW)) == ("operate", "view")
    assert Door(WIDE, 8080, token=TOKEN, view_only=True).rights(TOKEN) == "view"
    assert Door("127.0.0.1", 8080, view_only=True).most == "view"


# --- requests -------------------------------------------------------------------------------------

OURS = {"X_Forcemesh": "1"}  # a header that pages of other origins cannot send


@pytest.mark.parametrize(
    ("door", "path", "headers", "status"),
    [
        (LOCAL, "/", {}, 200),
        (LOCAL, "/", {"Host": "localhost:9999"}, 200),  # a tunnel
        (LOCAL, "/", {"Host": "[::1]:8080"}, 200),
        (LOCAL, "/", {"Origin": f"http://{HERE}"}, 200),
        (LOCAL, "/", {"Host": "other.example"}, 403),  # a name that was rebound to this machine
        (LOCAL, "/", {"Host": "127.0.0.1.other.example:8080"}, 403),
        (LOCAL, "/", {"Host": ""}, 403),
        (LOCAL, "/", {"Origin": "http://other.example"}, 403),
        (LOCAL, "/", {"Origin": "http://127.0.0.1:8081"}, 403),
        (LOCAL, "/", {"Origin": "null"}, 403),
        (LOCAL, "/alive", {"Host": "anything"}, 200),
        (LOCAL, "/nothing", {}, 404),
        (LOCAL, "/stop", {}, 404),  # an image of another page could request this
        (LOCAL, "/stop", OURS, 200),
        (LOCKED, "/", {}, 401),
        (LOCKED, "/stop", OURS, 401),
        (LOCKED, "/?token=wrong", {}, 401),
        (LOCKED, f"/?token={TOKEN}", {}, 200),
        (LOCKED, f"/?token={TOKEN}", {"Origin": "http://other.example"}, 403),
        (LOCKED, "/", {"X_Forcemesh_Token": TOKEN} | OURS, 200),
        (LOCKED, "/", {"X_Forcemesh_Token": TOKEN}, 401),  # not from the panel's own form
        (LOCKED, f"/?token={TOKEN}", {"Upgrade": "websocket"}, 401),  # it would be logged
        *(
            (LOCKED, "/", {"Cookie": cookie}, 401)
            for cookie in (f"{LOCKED.cookie}={TOKEN}", f"{LOCKED.cookie}=", "x=y")
        ),
    ],
)
def test_each_request_has_its_answer(door, path, headers, status):
    """Foreign pages are refused first; then a token, a session and the panel's own header count."""
    assert answer_of(gate_of(door), path, **headers).status_code == status


@pytest.mark.parametrize("by_form", [False, True])
@pytest.mark.parametrize(("token", "rights"), [(TOKEN, "operate"), (VIEW, "view")])
def test_a_token_begins_a_session_and_is_not_kept_in_the_browser(by_form, token, rights):
    """Its cookie is random, only this panel's pages send it; it ends by age and with its panel."""
    clock = ManualClock()
    gate = gate_of(LOCKED, clock=clock)
    gate.ready = True
    if by_form:
        entered = answer_of(gate, X_Forcemesh_Token=token, **OURS)
    else:
        entered = answer_of(gate, f"/?token={token}")
        assert b'http-equiv="refresh" content="0; url=/"' in entered.body
    kept = entered.headers["Set-Cookie"]
    assert token not in kept
    assert kept.startswith("__Host-forcemesh_panel_8080=")
    assert kept.endswith("; HttpOnly; SameSite=Strict; Secure")  # never sent in the clear
    cookie = kept.partition(";")[0]
    assert json.loads(answer_of(gate, "/stop", Cookie=cookie, **OURS).body) == {"rights": rights}
    assert answer_of(gate, Upgrade="websocket", Cookie=cookie) is None
    assert answer_of(gate_of(LOCKED), Cookie=cookie).status_code == 401
    clock.advance_ns(round(SESSION_IDLE_S * NS_PER_S))
    assert answer_of(gate, Cookie=cookie).status_code == 401


def test_the_page_runs_its_own_scripts_and_calls_no_other_host():
    """Each answer has a new number, which all of its scripts have; the policy permits no other."""
    gate, nonces, body, policy = gate_of(LOCAL, "<b>cell</b>"), set(), "", ""
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
    assert "Stop motion" in body
    assert "default-src 'self'" in policy
    for directive in ("frame-src", "object-src", "frame-ancestors", "base-uri"):
        assert f"{directive} 'none'" in policy
    assert "http" not in policy
    assert policy.count("ws:") == policy.count(f"ws://{HERE}") == 1
    locked = gate_of(LOCKED)
    cookie = answer_of(locked, f"/?token={TOKEN}").headers["Set-Cookie"].partition(";")[0]
    injected = answer_of(locked, Host="x; script-src *", Cookie=cookie)
    assert injected.status_code == 200
    assert "script-src *" not in injected.headers["Content-Security-Policy"]


# --- viser ----------------------------------------------------------------------------------------


def test_a_viser_that_bypasses_the_door_or_starts_otherwise_is_refused(monkeypatch):
    """At the start: no socket stays open, no page stays empty; its tunnel is switched off."""

    async def let_pass(_gate, _request):
        return None

    assert PanelServer.request_share_url(object.__new__(PanelServer)) is None
    with pytest.raises(ForcemeshError, match=r"refused: .*Content-Security-Policy"):
        with_nonce_unpacked("<script>start()</script>")
    monkeypatch.setattr(Gate, "before", let_pass)
    door = Door("127.0.0.1", free_port())
    with pytest.raises(ForcemeshError, match=r"bypasses the panel's access|does not answer"):
        open_server(gate_of(door), door)
    listen("127.0.0.1", door.port).close()


def test_the_command_line_precedes_the_environment_and_both_the_cell_file():
    """Each of the three sources may have the address and the token."""
    section = PanelSection(host="127.0.0.1", port=8081, token="a" * 16)
    found = door_of(section, {"FORCEMESH_PANEL_TOKEN": TOKEN}, host=WIDE, port=9000)
    assert (found.host, found.port, found.token) == (WIDE, 9000, TOKEN)
    found = door_of(section, {})
    assert (found.host, found.port, found.token) == ("127.0.0.1", 8081, "a" * 16)

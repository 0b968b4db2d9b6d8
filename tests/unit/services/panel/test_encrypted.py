"""The panel's page beyond this machine: by TLS, with a certificate that is nobody on the bus."""

import asyncio
import datetime as dt
import http.client
import socket
import ssl
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import ExtendedKeyUsageOID
from typer.testing import CliRunner
from websockets.asyncio.client import connect
from websockets.typing import Origin

from cli.__main__ import app
from common.config.load import load_cell
from common.security.pki import (
    make_authority,
    make_page_authority,
    make_page_certificate,
    read_certificate,
    write_pair,
)
from common.security.pki_check import check_folder
from forcemesh.errors import ForcemeshError
from forcemesh.identity import NAMES, PAGE, PAGE_AUTHORITY
from services.panel.access import Door
from services.panel.encrypted import context_of
from services.panel.server import Gate, close_server, open_server

DEMO = Path(__file__).parents[4] / "cells" / "demo.yaml"
NOW = dt.datetime.now(dt.UTC)
TOKEN = "0123456789abcdef"  # noqa: S105 - of this test
WIDE = "0.0.0.0"


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A folder with the page's certificate and its authority, which the panel finds."""
    authority = make_page_authority("demo", NOW)
    write_pair(tmp_path, PAGE_AUTHORITY, authority, owner=None)
    hosts = ["localhost", "127.0.0.1"]
    pair = make_page_certificate(authority, "demo", hosts=hosts, days=9, now=NOW)
    write_pair(tmp_path, PAGE, pair, owner=None)
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    return tmp_path


def wide(port: int = 8080) -> Door:
    """Return a door that others reach."""
    return Door(WIDE, port, token=TOKEN)


def test_beyond_this_machine_there_is_no_panel_without_a_certificate(tmp_path, monkeypatch):
    """One sentence: where, what is missing, what makes it, what would do as well."""
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    cell = load_cell(DEMO)
    for host in ("127.0.0.1", "localhost", "::1"):
        assert context_of(cell, Door(host, 8080, token=TOKEN)) is None
    said = (
        r"refused: on 0\.0\.0\.0 .*panel-page\.pem.* is missing.*pki issue panel-page.*127\.0\.0\.1"
    )
    with pytest.raises(ForcemeshError, match=said):
        context_of(cell, wide())
    (tmp_path / f"{PAGE}.pem").write_text("no certificate")
    (tmp_path / f"{PAGE}.key").write_text("no key")
    with pytest.raises(ForcemeshError, match=r"refused: .* cannot be used"):
        context_of(cell, wide())


def test_in_a_container_the_published_address_decides(tmp_path, monkeypatch):
    """It listens on every address there; who reaches it is what compose says."""
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    here = Door(WIDE, 8080, published="127.0.0.1")
    assert context_of(load_cell(DEMO), here) is None
    wider = Door(WIDE, 8080, token=TOKEN, published="192.168.1.7")
    with pytest.raises(ForcemeshError, match=r"refused: on 192\.168\.1\.7 the token"):
        context_of(load_cell(DEMO), wider)


def test_a_cookie_of_an_encrypted_page_never_leaves_in_the_clear(folder):
    """The browser is told so twice: by its name and by a word."""
    assert wide().keep("number").startswith("__Host-forcemesh_panel_8080=number; Path=/; ")
    assert wide().keep("number").endswith("; HttpOnly; SameSite=Strict; Secure")
    here = Door("127.0.0.1", 8080, token=TOKEN).keep("number")
    assert "Secure" not in here
    assert "__Host-" not in here


def test_the_pages_authority_is_nobody_on_the_bus(folder):
    """Neither authority signs for the other; the page's certificate is good for a server."""
    bus = make_authority("demo", NOW).certificate
    page = read_certificate(folder / f"{PAGE}.pem")
    authority = read_certificate(folder / f"{PAGE_AUTHORITY}.pem")
    page.verify_directly_issued_by(authority)
    with pytest.raises((InvalidSignature, ValueError)):
        page.verify_directly_issued_by(bus)
    usage = page.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.SERVER_AUTH]
    assert not {PAGE, PAGE_AUTHORITY} & set(NAMES)  # no role, no person, no rule of access


def pki(*words: str, folder: Path) -> tuple[int, str]:
    """Run `forcemesh pki`; return exit code and what was said."""
    given = ["pki", *words, "--cell", str(DEMO), "--folder", str(folder)]
    result = CliRunner().invoke(app, given)
    return result.exit_code, result.output


def test_pki_makes_renews_and_judges_the_pages_certificate(tmp_path):
    """`init` makes it, `issue panel-page` one for other names, `check` looks at it."""
    assert pki("init", "--host", "labpc", folder=tmp_path)[0] == 0
    assert pki("check", folder=tmp_path)[0] == 0
    first = read_certificate(tmp_path / f"{PAGE}.pem")
    first.verify_directly_issued_by(read_certificate(tmp_path / f"{PAGE_AUTHORITY}.pem"))
    assert (tmp_path / f"{PAGE_AUTHORITY}.key").stat().st_mode & 0o077 == 0
    assert pki("issue", PAGE, folder=tmp_path)[0] == 2  # is there already
    assert pki("issue", PAGE, "--again", "--host", "10.0.0.7", folder=tmp_path)[0] == 0
    page = read_certificate(tmp_path / f"{PAGE}.pem")
    names = page.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "10.0.0.7" in [str(each) for each in names.get_values_for_type(x509.IPAddress)]
    page.verify_directly_issued_by(read_certificate(tmp_path / f"{PAGE_AUTHORITY}.pem"))
    late = check_folder(tmp_path, "demo", dt.datetime.now(dt.UTC) + dt.timedelta(days=400))
    assert [each.verdict for each in late if each.name == PAGE] == ["wrong"]
    other = make_page_authority("demo", NOW)
    write_pair(tmp_path, PAGE_AUTHORITY, other, owner=None)
    assert "panel-ca.pem here has not signed it" in pki("check", folder=tmp_path)[1]


def test_a_folder_that_has_no_page_yet_gets_one_beside_its_bus(tmp_path):
    """Certificates of an older forcemesh stay as they are."""
    assert pki("init", folder=tmp_path)[0] == 0
    before = (tmp_path / "hub.pem").read_bytes()
    for path in tmp_path.glob("panel-*"):
        path.unlink()
    assert pki("check", folder=tmp_path)[0] == 0
    assert pki("issue", PAGE, folder=tmp_path)[0] == 0
    assert (tmp_path / "hub.pem").read_bytes() == before
    assert pki("check", folder=tmp_path)[0] == 0


@pytest.mark.realtime
def test_the_page_is_served_by_tls_alone(folder):
    """Who trusts panel-ca reaches page and websocket; in the clear, or without it, nobody does."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    door = wide(port)
    gate = Gate(door, "cell")
    server = open_server(gate, door, context_of(load_cell(DEMO), door))
    gate.ready = True
    trusting = ssl.create_default_context(cafile=str(folder / f"{PAGE_AUTHORITY}.pem"))
    try:
        asking = http.client.HTTPSConnection("localhost", port, timeout=10, context=trusting)
        with closing(asking):
            asking.request("GET", f"/?token={TOKEN}")
            reply = asking.getresponse()
        assert reply.status == 200
        cookie = reply.headers["Set-Cookie"].partition(";")[0]
        assert TOKEN not in cookie
        ours = Origin(f"https://localhost:{port}")
        headers = {"Cookie": cookie}
        url = f"wss://localhost:{port}"
        asyncio.run(open_and_close(url, trusting, origin=ours, additional_headers=headers))
        with pytest.raises(ssl.SSLCertVerificationError):
            asyncio.run(open_and_close(url, ssl.create_default_context()))
        with pytest.raises((OSError, http.client.HTTPException)):
            in_the_clear(port)
    finally:
        close_server(server)


async def open_and_close(url: str, context: ssl.SSLContext, **how: Any) -> None:
    """Open a websocket by TLS, as a page does, and close it.

    With the client of one thread: the one of `websockets.sync` reads in a second thread while the
    first one writes, which OpenSSL forbids on one connection (cpython issue 143756). Beside other
    work, 24 of a thousand such connections lost their request.
    """
    async with connect(url, ssl=context, proxy=None, **how):
        pass


def in_the_clear(port: int) -> int:
    """Ask without TLS; return the status of the answer, should there be one."""
    plain = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    with closing(plain):
        plain.request("GET", "/")
        return plain.getresponse().status

"""The panel's page for other hosts: TLS, with a certificate without rights on the bus."""

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
    make_certificate,
    read_certificate,
    write_pair,
)
from common.security.pki_check import check_folder
from forcemesh.errors import ForcemeshError
from forcemesh.identity import NAMES, PAGE, PAGE_AUTHORITY
from services.panel.access import Door, context_of
from services.panel.server import Gate, close_server, open_server

DEMO = Path(__file__).parents[4] / "cells" / "demo.yaml"
NOW = dt.datetime.now(dt.UTC)
TOKEN = "0123456789abcdef"  # noqa: S105 - of this test
WIDE = "0.0.0.0"


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Return a folder with the page's certificate and its authority, which the panel finds."""
    authority = make_authority("demo", NOW, of_page=True)
    write_pair(tmp_path, PAGE_AUTHORITY, authority, owner=None)
    hosts = ["localhost", "127.0.0.1"]
    pair = make_certificate(authority, PAGE, "demo", hosts=hosts, days=9, now=NOW)
    write_pair(tmp_path, PAGE, pair, owner=None)
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    return tmp_path


def wide(port: int = 8080) -> Door:
    """Return a door that other hosts reach."""
    return Door(WIDE, port, token=TOKEN)


def test_for_other_hosts_there_is_no_panel_without_a_certificate(tmp_path, monkeypatch):
    """The error is one sentence: the address, the missing file, the remedy and its alternative."""
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    cell = load_cell(DEMO)
    for host in ("127.0.0.1", "localhost", "::1"):
        assert context_of(cell, Door(host, 8080, token=TOKEN)) is None
    message = (
        r"refused: on 0\.0\.0\.0 .*panel-page\.pem.* is missing.*pki issue panel-page.*127\.0\.0\.1"
    )
    with pytest.raises(ForcemeshError, match=message):
        context_of(cell, wide())
    (tmp_path / f"{PAGE}.pem").write_text("no certificate")
    (tmp_path / f"{PAGE}.key").write_text("no key")
    with pytest.raises(ForcemeshError, match=r"refused: .* cannot be used"):
        context_of(cell, wide())


def test_in_a_container_the_published_address_decides(tmp_path, monkeypatch):
    """The process listens on every address there; compose decides which hosts reach it."""
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    local = Door(WIDE, 8080, published="127.0.0.1")
    assert context_of(load_cell(DEMO), local) is None
    wider = Door(WIDE, 8080, token=TOKEN, published="192.168.1.7")
    with pytest.raises(ForcemeshError, match=r"refused: on 192\.168\.1\.7 the token"):
        context_of(load_cell(DEMO), wider)


def test_a_cookie_of_an_encrypted_page_is_never_sent_in_the_clear(folder):
    """Its name and its attribute both require this of the browser."""
    assert wide().keep("number").startswith("__Host-forcemesh_panel_8080=number; Path=/; ")
    assert wide().keep("number").endswith("; HttpOnly; SameSite=Strict; Secure")
    cookie = Door("127.0.0.1", 8080, token=TOKEN).keep("number")
    assert "Secure" not in cookie
    assert "__Host-" not in cookie


def test_the_pages_authority_has_no_rights_on_the_bus(folder):
    """Neither authority signs for the other; the page's certificate is valid for a server."""
    bus = make_authority("demo", NOW).certificate
    page = read_certificate(folder / f"{PAGE}.pem")
    authority = read_certificate(folder / f"{PAGE_AUTHORITY}.pem")
    page.verify_directly_issued_by(authority)
    with pytest.raises((InvalidSignature, ValueError)):
        page.verify_directly_issued_by(bus)
    usage = page.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.SERVER_AUTH]
    assert not {PAGE, PAGE_AUTHORITY} & set(NAMES)  # no role, no user, no access rule


def pki(*arguments: str, folder: Path) -> tuple[int, str]:
    """Run `forcemesh pki`; return exit code and output."""
    given = ["pki", *arguments, "--cell", str(DEMO), "--folder", str(folder)]
    result = CliRunner().invoke(app, given)
    return result.exit_code, result.output


def test_pki_makes_renews_and_checks_the_pages_certificate(tmp_path):
    """`init` makes it, `issue panel-page` makes one for other names, `check` inspects it."""
    assert pki("init", "--host", "labpc", folder=tmp_path)[0] == 0
    assert pki("check", folder=tmp_path)[0] == 0
    first = read_certificate(tmp_path / f"{PAGE}.pem")
    first.verify_directly_issued_by(read_certificate(tmp_path / f"{PAGE_AUTHORITY}.pem"))
    assert (tmp_path / f"{PAGE_AUTHORITY}.key").stat().st_mode & 0o077 == 0
    assert pki("issue", PAGE, folder=tmp_path)[0] == 2  # it exists already
    assert pki("issue", PAGE, "--again", "--host", "10.0.0.7", folder=tmp_path)[0] == 0
    page = read_certificate(tmp_path / f"{PAGE}.pem")
    names = page.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "10.0.0.7" in [str(each) for each in names.get_values_for_type(x509.IPAddress)]
    page.verify_directly_issued_by(read_certificate(tmp_path / f"{PAGE_AUTHORITY}.pem"))
    late = check_folder(tmp_path, "demo", dt.datetime.now(dt.UTC) + dt.timedelta(days=400))
    assert [each.verdict for each in late if each.name == PAGE] == ["wrong"]
    other = make_authority("demo", NOW, of_page=True)
    write_pair(tmp_path, PAGE_AUTHORITY, other, owner=None)
    assert "panel-ca.pem here has not signed it" in pki("check", folder=tmp_path)[1]


def test_a_folder_without_a_page_certificate_gets_one(tmp_path):
    """Certificates of an older forcemesh stay unchanged."""
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
    """A client that trusts panel-ca reaches page and websocket; without TLS or trust none does."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    door = wide(port)
    gate = Gate(door, "cell")
    server = open_server(gate, door, context_of(load_cell(DEMO), door))
    gate.ready = True
    trusting = ssl.create_default_context(cafile=str(folder / f"{PAGE_AUTHORITY}.pem"))
    try:
        connection = http.client.HTTPSConnection("localhost", port, timeout=10, context=trusting)
        with closing(connection):
            connection.request("GET", f"/?token={TOKEN}")
            reply = connection.getresponse()
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
            status_without_tls(port)
    finally:
        close_server(server)


async def open_and_close(url: str, context: ssl.SSLContext, **options: Any) -> None:
    """Open a websocket by TLS, as a page does, and close it.

    With the client of one thread: the one of `websockets.sync` reads in a second thread while the
    first one writes, which OpenSSL forbids on one connection (cpython issue 143756). Beside other
    work, 24 of a thousand such connections lost their request.
    """
    async with connect(url, ssl=context, proxy=None, **options):
        pass


def status_without_tls(port: int) -> int:
    """Request the page without TLS; return the status of the answer, if any."""
    plain = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    with closing(plain):
        plain.request("GET", "/")
        return plain.getresponse().status

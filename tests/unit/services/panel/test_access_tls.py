"""The panel's page for other hosts: TLS, with a certificate without rights on the bus."""

import asyncio
import datetime as dt
import http.client
import ssl
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import ExtendedKeyUsageOID
from websockets.asyncio.client import connect
from websockets.typing import Origin

from common.security.pki import make_authority, make_certificate, read_certificate, write_pair
from forcemesh.errors import ForcemeshError
from forcemesh.identity import NAMES, PAGE, PAGE_AUTHORITY
from services.panel.access import Door, context_of
from services.panel.server import Gate, close_server, open_server
from tests.chaos.common_net import free_port
from tests.fakes.bench import CELL, DEMO
from tests.fakes.verb_calls import run

NOW = dt.datetime.now(dt.UTC)
TOKEN = "0123456789abcdef"  # noqa: S105 - of this test
WIDE = "0.0.0.0"


def pki(*arguments: str, folder: Path) -> tuple[int, str]:
    """Run `forcemesh pki`; return exit code and output."""
    result = run("pki", *arguments, "--cell", DEMO, "--folder", folder)
    return result.exit_code, result.output


def test_for_other_hosts_there_is_no_panel_without_a_certificate(tmp_path, monkeypatch):
    """The error has the address, the missing file, the remedy and its alternative."""
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    for host, published in (("localhost", ""), ("::1", ""), (WIDE, "127.0.0.1")):
        assert context_of(CELL, Door(host, 8080, published=published)) is None
    for published in ("", "192.168.1.7"):
        reached = (published or WIDE).replace(".", r"\.")
        missing = rf"refused: on {reached} .*{PAGE}\.pem.* is missing.*pki issue {PAGE}.*127\.0\.0"
        with pytest.raises(ForcemeshError, match=missing):
            context_of(CELL, Door(WIDE, 8080, token=TOKEN, published=published))
    (tmp_path / f"{PAGE}.pem").write_text("no certificate")
    (tmp_path / f"{PAGE}.key").write_text("no key")
    with pytest.raises(ForcemeshError, match=r"refused: .* cannot be used"):
        context_of(CELL, Door(WIDE, 8080, token=TOKEN))


def test_pki_makes_the_pages_certificate_of_an_authority_of_its_own(tmp_path):
    """The bus does not trust it; it is for a server, under no name of the bus."""
    assert pki("init", "--host", "labpc", folder=tmp_path)[0] == 0
    page = read_certificate(tmp_path / f"{PAGE}.pem")
    page.verify_directly_issued_by(read_certificate(tmp_path / f"{PAGE_AUTHORITY}.pem"))
    with pytest.raises((InvalidSignature, ValueError)):
        page.verify_directly_issued_by(read_certificate(tmp_path / "ca.pem"))
    usage = page.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.SERVER_AUTH]
    assert not {PAGE, PAGE_AUTHORITY} & set(NAMES)  # no role, no user, no access rule
    assert (tmp_path / f"{PAGE_AUTHORITY}.key").stat().st_mode & 0o077 == 0


@pytest.mark.realtime
def test_the_page_is_served_by_tls_alone(tmp_path, monkeypatch):
    """A client that trusts panel-ca reaches page and websocket; without TLS or trust none does."""
    authority = make_authority("demo", NOW, of_page=True)
    write_pair(tmp_path, PAGE_AUTHORITY, authority, owner=None)
    hosts = ["localhost", "127.0.0.1"]
    pair = make_certificate(authority, PAGE, "demo", hosts=hosts, days=9, now=NOW)
    write_pair(tmp_path, PAGE, pair, owner=None)
    monkeypatch.setenv("FORCEMESH_PKI", str(tmp_path))
    port = free_port()
    door = Door(WIDE, port, token=TOKEN)
    gate = Gate(door, "cell")
    server = open_server(gate, door, context_of(CELL, door))
    gate.ready = True
    trusting = ssl.create_default_context(cafile=str(tmp_path / f"{PAGE_AUTHORITY}.pem"))
    try:
        connection = http.client.HTTPSConnection("localhost", port, timeout=10, context=trusting)
        with closing(connection):
            connection.request("GET", f"/?token={TOKEN}")
            reply = connection.getresponse()
        assert reply.status == 200
        cookie = reply.headers["Set-Cookie"].partition(";")[0]
        ours = Origin(f"https://localhost:{port}")
        url = f"wss://localhost:{port}"
        headers = {"Cookie": cookie}
        asyncio.run(open_and_close(url, trusting, origin=ours, additional_headers=headers))
        with pytest.raises(ssl.SSLCertVerificationError):
            asyncio.run(open_and_close(url, ssl.create_default_context()))
        with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as plain:
            plain.request("GET", "/")
            with pytest.raises((OSError, http.client.HTTPException)):
                plain.getresponse()
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


def test_the_pages_certificate_is_renewed_alone(tmp_path):
    """For other names, or where an older folder has none; the bus keeps its certificates."""
    assert pki("init", "--host", "labpc", folder=tmp_path)[0] == 0
    hub = (tmp_path / "hub.pem").read_bytes()
    assert pki("issue", PAGE, folder=tmp_path)[0] == 2  # it exists already
    assert pki("issue", PAGE, "--again", "--host", "10.0.0.7", folder=tmp_path)[0] == 0
    page = read_certificate(tmp_path / f"{PAGE}.pem")
    names = page.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "10.0.0.7" in [str(each) for each in names.get_values_for_type(x509.IPAddress)]
    for path in tmp_path.glob("panel-*"):
        path.unlink()  # as in an older folder
    assert pki("issue", PAGE, folder=tmp_path)[0] == 0
    assert pki("check", folder=tmp_path)[0] == 0
    assert (tmp_path / "hub.pem").read_bytes() == hub

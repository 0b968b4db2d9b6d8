"""Actions that a process must not take on a bus that leaves this machine, and its name there."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.cell_bus import hub_settings
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh.errors import BusError
from forcemesh.identity import (
    FOLDER_VARIABLE,
    NAME_VARIABLE,
    identity_of,
    refuse_in_the_clear,
    stays_here,
)
from forcemesh.published_ports import HUB_PUBLISHED
from forcemesh.topics import CLIENT
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE, client_settings, security_of

DEMO = Path(__file__).resolve().parents[4] / "cells" / "demo.yaml"
HERE = ["tcp/localhost:7447", "udp/127.0.0.1:7?rel=1",
        "unixsock-stream//run/forcemesh.sock"]  # fmt: skip
ELSEWHERE = ["tcp/0.0.0.0:7447", "tcp/hub:7447", "udp/10.0.0.1:7447", "ws/hub:7447",
             "tcp/localhost.example.org:7447", "tcp/127.0.0.1.example.org:7447"]  # fmt: skip


@pytest.fixture(autouse=True)
def _nothing_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (ENDPOINT_VARIABLE, FOLDER_VARIABLE, NAME_VARIABLE):
        monkeypatch.delenv(name, raising=False)


def cell(**bus: object) -> CellConfig:
    """Return the demo's cell with settings of its bus."""
    return load_cell(DEMO, {f"bus.{name}": value for name, value in bus.items()})


def touch_pair(folder: Path, *names: str) -> None:
    """Put empty files where certificates of these names would be."""
    for name in ("ca.pem", *(f"{name}.{end}" for name in names for end in ("pem", "key"))):
        (folder / name).touch()


@given(st.ip_addresses())
def test_this_machine_needs_no_certificate(address) -> None:
    """Of all addresses just those that no packet leaves the machine for are taken for safe."""
    text = f"[{address}]" if address.version == 6 else str(address)
    assert stays_here(f"tcp/{text}:7447") == address.is_loopback
    for endpoint in HERE:
        assert stays_here(endpoint)
        assert security_of(cell(), "arbiter", endpoint) == {}


@pytest.mark.parametrize("endpoint", ELSEWHERE)
@pytest.mark.parametrize("role", ["hub", "arbiter", CLIENT])
def test_no_process_uses_an_open_bus_without_an_explicit_setting(endpoint: str, role: str) -> None:
    """Every role refuses an address that others reach, and names both remedies."""
    with pytest.raises(BusError, match=r"refused: .*pki init.*insecure: true"):
        security_of(cell(), role, endpoint)
    assert security_of(cell(insecure=True), role, endpoint) == {}


@pytest.mark.parametrize("endpoint", ["tcp/hub:7447", "tcp/0.0.0.0:7447"])
def test_a_hub_in_a_container_is_judged_by_the_address_that_compose_publishes(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Published on loopback it stays here; on any other address, or none, it is refused."""
    monkeypatch.setenv(HUB_PUBLISHED, "127.0.0.1")
    assert security_of(cell(), "arbiter", endpoint) == {}
    with pytest.raises(BusError, match="refused"):  # a name that is not the hub of this machine
        security_of(cell(), "arbiter", "tcp/labpc:7447")
    for wider in ("0.0.0.0", "192.168.1.7", "::", "labpc", ""):
        monkeypatch.setenv(HUB_PUBLISHED, wider)
        with pytest.raises(BusError, match=r"refused: .*pki init"):
            security_of(cell(), "arbiter", endpoint)


def test_both_ends_of_a_link_prove_their_names(tmp_path: Path) -> None:
    """Both show certificates, check the name in the other, and leave when it ends.

    So TLS and QUIC may leave the machine.
    """
    refuse_in_the_clear(cell(), "quic/hub:7447")
    touch_pair(tmp_path, "hub", "wrench")
    secure = cell(tls={"folder": str(tmp_path)})
    endpoint = "tls/192.168.1.7:7447"
    client = client_settings(endpoint, "wrench", security_of(secure, "wrench", endpoint))
    for settings in (client, hub_settings(secure, endpoint)):
        link = settings["transport"]["link"]
        assert "tcp" not in link["protocols"]
        for word in ("enable_mtls", "verify_name_on_connect", "close_link_on_expiration"):
            assert link["tls"][word] is True
    assert client["transport"]["link"]["tls"]["connect_private_key"].endswith("/wrench.key")


def test_a_hub_with_certificates_denies_everything_that_is_not_allowed(tmp_path: Path) -> None:
    """Access control is on, by default everything is denied, and long messages end there."""
    touch_pair(tmp_path, "hub")
    settings = hub_settings(cell(tls={"folder": str(tmp_path)}), "tls/0.0.0.0:7447")
    assert settings["access_control"]["enabled"] is True
    assert settings["access_control"]["default_permission"] == "deny"
    assert settings["low_pass_filter"][0]["key_exprs"] == ["**"]
    assert settings["scouting"]["multicast"]["enabled"] is False


@pytest.mark.parametrize("missing", ["ca.pem", "wrench.pem", "wrench.key"])
def test_a_missing_file_is_named_with_the_remedy(tmp_path: Path, missing: str) -> None:
    """Also one that cannot be read, as a folder in its place or a file of another user."""
    touch_pair(tmp_path, "wrench")
    (tmp_path / missing).unlink()
    secure = cell(tls={"folder": str(tmp_path)})
    with pytest.raises(BusError, match=f"{missing} is missing; `forcemesh pki init --cell FILE`"):
        identity_of(secure, "wrench")
    (tmp_path / missing).mkdir()
    with pytest.raises(BusError, match=f"{missing} cannot be read .* readable by the user"):
        identity_of(secure, "wrench")

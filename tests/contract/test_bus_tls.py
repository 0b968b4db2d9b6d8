"""A bus with certificates, with real hubs and clients: authentication and access control."""

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest
import zenoh
from typer.testing import CliRunner

from cli.__main__ import app
from common.bus.cell_bus import hub_settings, open_bus, open_hub
from common.config.cell import CellConfig
from common.config.load import dump_cell, load_cell
from forcemesh import topics
from forcemesh.errors import BusError
from forcemesh.identity import FOLDER_VARIABLE, NAME_VARIABLE, NAMES, Identity
from forcemesh.topics import REQUESTS, TOPICS
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE, client_settings
from services.hub.service import MOST_LINKS, Hub
from tests.chaos.common_net import free_port

pytestmark = pytest.mark.realtime

DEMO = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
PATIENCE_S = 20.0  # of the test, for a loaded machine
QUIET_S = 0.3  # long enough for every permitted message to arrive


@pytest.fixture(autouse=True)
def _nothing_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (ENDPOINT_VARIABLE, FOLDER_VARIABLE, NAME_VARIABLE):
        monkeypatch.delenv(name, raising=False)


def make_tls_cell(folder: Path, name: str = "tls", **bus: object) -> CellConfig:
    """Return a cell with certificates in a folder."""
    overrides = {
        "cell": name,
        "bus.endpoint": f"tls/127.0.0.1:{free_port()}",
        "bus.tls": {"folder": str(folder)},
        **{f"bus.{key}": value for key, value in bus.items()},
    }
    return load_cell(DEMO, overrides)


def make_certificates(cell: CellConfig, folder: Path, scratch: Path, *words: str) -> None:
    """Make all certificates of a cell."""
    path = scratch / f"{cell.cell}.yaml"
    path.write_text(dump_cell(cell))
    arguments = ["pki", "init", "--cell", str(path), "--folder", str(folder), *words]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for all tests of this file, with certificates in `pki`."""
    folder = tmp_path_factory.mktemp("tls")
    make_certificates(make_tls_cell(folder / "pki"), folder / "pki", folder)
    return folder


@pytest.fixture
def cell(scratch: Path) -> CellConfig:
    """A cell with certificates."""
    return make_tls_cell(scratch / "pki")


@pytest.fixture
def sessions(cell: CellConfig) -> Iterator[dict[str, zenoh.Session]]:
    """A hub, and a session of every name on it."""
    with open_hub(cell):
        opened = {name: session_of(cell, name) for name in NAMES if name != "hub"}
        yield opened
        for session in opened.values():
            with suppress(zenoh.ZError):
                session.close()


def session_of(cell: CellConfig, name: str, folder: Path | None = None) -> zenoh.Session:
    """Return a session with a name's certificate, restricted by the hub alone."""
    where = folder or Path(cell.bus.tls.folder if cell.bus.tls else "")
    settings = client_settings(cell.bus.endpoint, name, Identity(name, where).settings())
    give_up_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
        except zenoh.ZError:
            if time.monotonic() >= give_up_s:
                raise


def test_every_name_is_received_on_its_own_keys_and_on_no_other(
    cell: CellConfig, sessions: dict[str, zenoh.Session]
) -> None:
    """All pairs of name and key on a real hub: received if the table names the writer."""
    received: set[tuple[str, str]] = set()

    def record_sample(sample: zenoh.Sample) -> None:
        received.add((sample.payload.to_string(), str(sample.key_expr)))

    listening = sessions["monitor"].declare_subscriber(f"{cell.cell}/**", record_sample)
    expected = set()
    keys = [topic.key for topic in TOPICS] + [request.key for request in REQUESTS]
    for topic in TOPICS:
        roles = ("robot", "sensor") if topic.writer == "sensor" else (topic.writer,)
        expected |= {(role, f"{cell.cell}/{topic.key}") for role in roles if role != "hub"}
    give_up_s = time.monotonic() + PATIENCE_S
    while not expected <= received and time.monotonic() < give_up_s:
        for name, session in sessions.items():  # again: a busy machine drops messages
            for key in keys:
                session.put(f"{cell.cell}/{key}", name)
        time.sleep(QUIET_S)
    listening.undeclare()
    # A session receives its own messages without the hub.
    assert {pair for pair in received if pair[0] != "monitor"} == expected


@pytest.mark.parametrize("false_hub", [name for name in NAMES if name != "hub"])
def test_a_certificate_of_another_name_is_no_hub(
    cell: CellConfig, false_hub: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hub with the certificate of a monitor, a sensor or another name: every role rejects it."""
    folder = Path(cell.bus.tls.folder if cell.bus.tls else "")
    settings = hub_settings(cell, cell.bus.endpoint)
    settings["transport"]["link"]["tls"] = Identity(false_hub, folder).settings()
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))):

        def is_let_in(name: str) -> bool:
            own = client_settings(cell.bus.endpoint, name, Identity(name, folder).settings())
            try:
                zenoh.open(zenoh.Config.from_json5(json.dumps(own))).close()
            except zenoh.ZError:
                return False
            return True

        with ThreadPoolExecutor(len(NAMES)) as pool:  # each waits until its time-out
            assert not any(pool.map(is_let_in, NAMES))
    with open_hub(cell):  # and all of them connect to the correct one
        for name in set(NAMES) - {"hub"}:
            session_of(cell, name).close()


def test_only_requests_of_people_arrive(
    cell: CellConfig, sessions: dict[str, zenoh.Session]
) -> None:
    """Every name sends requests to the arbiter: only those of operator and panel arrive."""
    requesting: set[str] = set()
    people = {"operator", "panel"}

    def answer(query: zenoh.Query) -> None:
        assert query.payload is not None
        requesting.add(query.payload.to_string())
        query.reply(query.key_expr, b"yes")

    served = sessions["arbiter"].declare_queryable(f"{cell.cell}/{topics.HOLD.key}", answer)
    give_up_s = time.monotonic() + PATIENCE_S
    while requesting < people and time.monotonic() < give_up_s:
        for name in set(sessions) - {"arbiter"}:  # its own request would not leave its session
            list(sessions[name].get(f"{cell.cell}/{topics.HOLD.key}", payload=name, timeout=0.2))
    served.undeclare()
    assert requesting == people


def test_a_hub_without_access_control_is_not_worked_on(cell: CellConfig) -> None:
    """A role detects that its hub restricts no publisher, and refuses to run."""
    settings = hub_settings(cell, cell.bus.endpoint)
    del settings["access_control"]
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))):
        for role in ("arbiter", "sensor"):
            with (
                pytest.raises(BusError, match="accepts every message"),
                open_bus(cell, role, patience_s=PATIENCE_S),
            ):
                pass


def test_the_hub_names_who_has_too_many_links(cell: CellConfig) -> None:
    """By the name in the certificate, in its health; a client with few links is not named."""
    with open_hub(cell) as bus:
        hub = Hub(bus, cell)
        few = [session_of(cell, "operator")]
        assert hub.fault == ""
        many = [session_of(cell, "monitor") for _ in range(MOST_LINKS + 1)]
        give_up_s = time.monotonic() + PATIENCE_S
        while not hub.fault and time.monotonic() < give_up_s:
            time.sleep(0.05)
        assert hub.fault.startswith(f"monitor.tls has {MOST_LINKS + 1} links; more than")
        for session in [*few, *many]:
            session.close()

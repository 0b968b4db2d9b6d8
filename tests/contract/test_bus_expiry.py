"""A certificate that expires during work: its link is closed and not accepted again."""

import datetime as dt
import json
import time
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives import hashes

from common.bus.cell_bus import open_bus, open_hub
from common.config.cell import CellConfig
from common.security.pki import Pair, make_certificate, read_authority, write_pair
from forcemesh import topics
from forcemesh.clock import MonotonicClock
from forcemesh.identity import Identity
from forcemesh.messages import Permission, RobotCommand
from forcemesh.zenoh_settings import client_settings
from tests.contract.test_bus_tls import make_certificates, make_tls_cell

pytestmark = pytest.mark.realtime

VALID_S = 8.0  # long enough to connect on a loaded machine
PATIENCE_S = 30.0


@pytest.fixture
def cell(tmp_path: Path) -> CellConfig:
    """A cell with certificates of its own."""
    cell = make_tls_cell(tmp_path / "pki")
    make_certificates(cell, tmp_path / "pki", tmp_path)
    return cell


def shorten(folder: Path, name: str, cell: CellConfig, valid_s: float = VALID_S) -> float:
    """Replace a certificate by one that expires soon; return the expiry time, wall clock [s]."""
    authority, now = read_authority(folder), dt.datetime.now(dt.UTC)
    new = make_certificate(authority, name, cell.cell, hosts=[], days=1, now=now)
    ends = now.replace(microsecond=0) + dt.timedelta(seconds=valid_s)
    builder = (
        x509.CertificateBuilder()
        .subject_name(new.certificate.subject)
        .issuer_name(new.certificate.issuer)
        .public_key(new.key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(hours=1))
        .not_valid_after(ends)
    )
    for extension in new.certificate.extensions:
        builder = builder.add_extension(extension.value, critical=extension.critical)
    made = builder.sign(authority.key, hashes.SHA256())
    for kind in ("pem", "key"):
        (folder / f"{name}.{kind}").unlink()
    write_pair(folder, name, Pair(made, new.key), owner=None)
    return ends.timestamp()


def test_an_arbiter_whose_certificate_ends_is_cut_off_and_the_robot_holds(
    cell: CellConfig, tmp_path: Path
) -> None:
    """Its messages are received until expiry, then stale: the robot holds, the topic is the cause.

    The hub closes the open link; a new one with the same certificate is refused.
    """
    ends_s = shorten(tmp_path / "pki", "arbiter", cell)
    clock = MonotonicClock()
    with (
        open_hub(cell),
        open_bus(cell, "robot", patience_s=PATIENCE_S) as robot,
        open_bus(cell, "arbiter", patience_s=PATIENCE_S) as arbiter,
    ):
        commands = robot.reader(topics.ROBOT_COMMAND)
        put_command = arbiter.publisher(topics.ROBOT_COMMAND)
        leave = Permission(host="pc", lease=1, deadline_s=0.1, ownership=1)
        received_s = 0.0
        while time.time() < ends_s + 4.0:
            put_command.put(RobotCommand(kind="idle", permission=leave))
            time.sleep(0.01)
            if commands.read(clock.now_ns()).fresh is not None:
                received_s = time.time()
        assert received_s > 0.0, "this would prove nothing"
        assert received_s < ends_s + 2.0
        reading = commands.read(clock.now_ns())
        assert reading.silent
        assert "robot/command stale" in reading.fault
        identity = Identity("arbiter", tmp_path / "pki")
        settings = client_settings(cell.bus.endpoint, "arbiter", identity.settings())
        with pytest.raises(zenoh.ZError):
            zenoh.open(zenoh.Config.from_json5(json.dumps(settings))).close()
        # Other clients are not affected: a valid certificate is accepted at once.
        with open_bus(cell, "wrench", patience_s=PATIENCE_S):
            pass

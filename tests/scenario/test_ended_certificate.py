"""A certificate that expires while the arm of a whole cell presses, in processes."""

import datetime as dt
import subprocess
import time
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.security.pki import Pair, make_certificate, read_authority, write_pair
from forcemesh import topics
from forcemesh.messages import MAY_MOVE
from tests.chaos.common_net import CellUnderTest
from tests.scenario.conftest import PATIENCE_S, ROOT, wait_for
from tests.scenario.test_demo_processes import forcemesh, status_of

VALID_S = 45.0  # long enough to be up and to press on a loaded machine
LATE_S = 5.0  # until the hub has closed the link and the others have missed its messages

pytestmark = [pytest.mark.realtime, pytest.mark.long, pytest.mark.timeout(300)]


def shorten(folder: Path, name: str, cell: CellConfig, valid_s: float) -> float:
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


@pytest.mark.parametrize("role", ["wrench", "arbiter"])
def test_the_arm_holds_and_the_screen_names_the_expired_certificate(
    tls_cell_file: Path,
    tmp_path: Path,
    start,
    role: str,
) -> None:
    """While pressing: held soon after, not before; no further motion; `pki check` names it."""
    cell = load_cell(tls_cell_file)
    ends_s = shorten(tmp_path / "pki", role, cell, VALID_S)
    wait_for(start("-m", "cli", "up", "--cell", tls_cell_file, "--no-panel"), "is up")
    with open_bus(cell, topics.CLIENT, patience_s=PATIENCE_S) as bus:
        client = CellUnderTest(cell, bus)
        client.make_ready()
        client.press(5.0)
        client.until(lambda: client.state == "ACTIVE", "force feedback")
        assert time.time() < ends_s - 2.0, "this machine is too slow for the test"
        while time.time() < ends_s - 1.0:
            assert client.state == "ACTIVE"
            time.sleep(0.05)
        client.until(lambda: client.held, "a hold")
        assert ends_s - 1.0 < time.time() < ends_s + LATE_S
        time.sleep(2.0)
        joints = client.joints()
        status = status_of(tls_cell_file)
        assert abs(client.joints() - joints).max() < 1e-3
    assert status["state"] not in MAY_MOVE
    (silent,) = (row for row in status["services"] if not row["alive"])
    assert silent["name"] == role
    assert "its certificate: expired on" in silent["fault"]
    assert f"forcemesh pki issue {role} --again" in silent["fault"]
    checked = subprocess.run(
        forcemesh("pki", "check", "--cell", tls_cell_file),
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert checked.returncode != 0
    assert f"wrong {role}: expired on" in checked.stdout

"""Certificates: made once, readable by one, checked with a remedy for everything that is wrong."""

import datetime as dt
import os
import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from typer.testing import CliRunner

from cli.__main__ import app
from common.security.pki import make_authority, make_certificate, read_authority, write_pair
from common.security.pki_check import CertificateFinding, check_folder
from forcemesh.identity import NAMES

ROOT = Path(__file__).resolve().parents[4]
NOW = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
DEMO = str(ROOT / "cells" / "demo.yaml")


def pki(*words: str, folder: Path) -> tuple[int, str]:
    """Run `forcemesh pki`; return exit code and output."""
    arguments = ["pki", *words, "--cell", DEMO, "--folder", str(folder)]
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.output


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with an authority of the demo and certificates of a year for every name."""
    authority = make_authority("demo", NOW)
    write_pair(tmp_path, "ca", authority, owner=None)
    for name in NAMES:
        issue(tmp_path, name)
    return tmp_path


def issue(folder: Path, name: str, *, days: int = 365, cell: str = "demo") -> None:
    """Put a certificate into a folder."""
    authority = read_authority(folder)
    pair = make_certificate(authority, name, cell, hosts=["localhost"], days=days, now=NOW)
    write_pair(folder, name, pair, owner=None)


def wrong(folder: Path, after_days: float = 0.0) -> list[CertificateFinding]:
    """Return the bad findings so many days after the folder was made."""
    found = check_folder(folder, "demo", NOW + dt.timedelta(days=after_days))
    return [finding for finding in found if finding.verdict != "good"]


def certificate(folder: Path, name: str) -> x509.Certificate:
    """Return a certificate of a folder."""
    return x509.load_pem_x509_certificate((folder / f"{name}.pem").read_bytes())


def test_init_makes_all_names_and_check_finds_nothing_wrong(tmp_path: Path) -> None:
    """Every role and person gets a certificate with its own name, for both ends of a link."""
    code, output = pki("init", "--host", "labpc", "--host", "192.168.1.7", folder=tmp_path / "pki")
    assert code == 0, output
    for name in NAMES:
        made = certificate(tmp_path / "pki", name)
        common_name = made.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value
        assert common_name == f"{name}.demo"
        usage = made.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        if name != "hub":  # no owner of this certificate can be a hub
            assert set(usage) == {ExtendedKeyUsageOID.CLIENT_AUTH}
            with pytest.raises(x509.ExtensionNotFound):
                made.extensions.get_extension_for_class(x509.SubjectAlternativeName)
            continue
        assert set(usage) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
        names = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert {name, "localhost", "labpc"} <= set(names.get_values_for_type(x509.DNSName))
        assert "192.168.1.7" in map(str, names.get_values_for_type(x509.IPAddress))
    assert pki("check", folder=tmp_path / "pki")[0] == 0


def test_only_the_owner_reads_any_file(tmp_path: Path) -> None:
    """Files are 0400 in a folder that is 0700, whatever the umask."""
    before = os.umask(0)
    try:
        assert pki("init", folder=tmp_path / "pki")[0] == 0
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "pki").stat().st_mode) == 0o700
    modes = {stat.S_IMODE(path.stat().st_mode) for path in (tmp_path / "pki").iterdir()}
    assert modes == {0o400}


def test_what_is_refused_changes_no_file(tmp_path: Path) -> None:
    """A second init or issue without `--again`, a host of a client, a name that is none."""
    pki("init", folder=tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for words, text in (
        ("init", "--again"),
        ("issue wrench", "--again"),
        ("issue monitor --again --host labpc", "--host is for hub and panel-page"),
        ("issue arbitre", "arbiter"),
    ):
        code, output = pki(*words.split(), folder=tmp_path)
        assert (code, text in output) == (2, True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert pki("issue", "wrench", "--again", folder=tmp_path)[0] == 0
    changed = {name for name in before if (tmp_path / name).read_bytes() != before[name]}
    assert changed == {"wrench.pem", "wrench.key"}
    assert pki("issue", "hub", "--again", "--host", "labpc", folder=tmp_path)[0] == 0


@pytest.mark.parametrize(("days", "verdict"), [(350.9, ""), (351.1, "soon"), (365.1, "wrong")])
def test_the_end_is_reported_two_weeks_before_and_after_it(
    folder: Path, days: float, verdict: str
) -> None:
    """Every name is reported, each with the command that makes a new one."""
    found = wrong(folder, after_days=days)
    assert {f.verdict for f in found} == ({verdict} if verdict else set())
    assert len(found) == (len(NAMES) if verdict else 0)
    assert all(f.remedy == f"forcemesh pki issue {f.name} --again" for f in found)
    # A certificate from the future is a matter of the clock, not of the certificate.
    assert {f.remedy for f in wrong(folder, after_days=-1)} == {"set the clock"}


def test_everything_that_is_wrong_with_a_certificate_is_named(folder: Path) -> None:
    """Missing, of another cell, of another authority, another's key, readable by others, broken."""
    (folder / "hub.pem").unlink()
    issue(folder, "robot", cell="other")
    other = make_authority("demo", NOW)
    pair = make_certificate(other, "sensor", "demo", hosts=["localhost"], days=9999, now=NOW)
    write_pair(folder, "sensor", pair, owner=None)
    (folder / "wrench.key").unlink()
    (folder / "wrench.key").write_bytes((folder / "arbiter.key").read_bytes())
    (folder / "wrench.key").chmod(0o400)
    (folder / "regulator.key").chmod(0o440)
    (folder / "operator.pem").unlink()
    (folder / "operator.pem").write_text("what is this")
    (folder / "monitor.key").unlink()
    output = {finding.name: finding.text for finding in wrong(folder)}
    assert output["hub"] == "missing"
    assert "it is for robot.other, not for robot.demo" in output["robot"]
    assert "has not signed it" in output["sensor"]
    assert "not the key of wrench.pem" in output["wrench"]
    assert "is readable by others (mode 440)" in output["regulator"]
    assert "no certificate" in output["operator"]
    assert "no key" in output["monitor"]
    assert set(output) == set(NAMES) - {"arbiter", "recorder", "panel"}


@pytest.mark.parametrize("name", ["wrench", "operator"])
def test_an_older_certificate_that_could_be_the_hub_is_wrong(
    folder: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Named, with the verb that makes a new one, and the one that ends a stolen one."""
    with monkeypatch.context() as older:
        older.setattr("common.security.pki.HUB", name)  # it was valid for both ends of a link
        issue(folder, name)
    (finding,) = wrong(folder)
    assert (finding.verdict, finding.name) == ("wrong", name)
    assert "can stand in for the hub until 2027-01-01" in finding.text
    assert "forcemesh pki init --again" in finding.text
    assert finding.remedy == f"forcemesh pki issue {name} --again"

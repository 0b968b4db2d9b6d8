"""Check of a folder of certificates: findings with their remedies."""

import datetime as dt
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID

from common.security.pki import can_be_the_hub, read_certificate
from forcemesh.errors import DataError
from forcemesh.identity import AUTHORITY, HUB, NAMES, PAGE, PAGE_AUTHORITY, common_name

SOON = dt.timedelta(days=14)
OTHERS = stat.S_IRWXG | stat.S_IRWXO
REMEDY = "forcemesh pki issue {name} --again"


@dataclass(frozen=True, slots=True)
class CertificateFinding:
    """One finding: verdict, name, text and remedy."""

    verdict: Literal["good", "soon", "wrong"]
    name: str
    text: str
    remedy: str = ""


def check_folder(folder: Path, cell: str, now: dt.datetime) -> list[CertificateFinding]:
    """Return the findings on every certificate of a cell; the authority first."""
    try:
        authority = read_certificate(folder / f"{AUTHORITY}.pem")
    except DataError as error:
        return [CertificateFinding("wrong", AUTHORITY, str(error), "forcemesh pki init")]
    found = list(_of_file(folder, AUTHORITY, authority, now))
    there = [name for name in NAMES if (folder / f"{name}.pem").exists()]
    for name in there:
        found += _of_name(folder, name, cell, authority, now=now)
    missing = [name for name in NAMES if name not in there]
    # A monitoring machine has one certificate; the authority's folder must hold all of them.
    if missing and (folder / f"{AUTHORITY}.key").exists():
        found += [
            CertificateFinding("wrong", name, "missing", REMEDY.format(name=name))
            for name in missing
        ]
    if not there:
        found.append(
            CertificateFinding("wrong", "all", "no certificate of any name", "forcemesh pki init")
        )
    if (folder / f"{PAGE}.pem").exists():  # of the panel, if it has one; only browsers receive it
        found += _of_name(folder, PAGE, cell, None, now=now)
    wrong = {finding.name for finding in found if finding.verdict == "wrong"}
    return [each for each in found if each.verdict != "good" or each.name not in wrong]


def _of_name(
    folder: Path, name: str, cell: str, authority: x509.Certificate | None, *, now: dt.datetime
) -> Iterator[CertificateFinding]:
    """Check one certificate; that of the panel's page has an authority of its own."""
    remedy = REMEDY.format(name=name)
    signer = PAGE_AUTHORITY if authority is None else AUTHORITY
    try:
        certificate = read_certificate(folder / f"{name}.pem")
        authority = authority or read_certificate(folder / f"{signer}.pem")
    except DataError as error:
        yield CertificateFinding("wrong", name, str(error), remedy)
        return
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    name_text = str(names[0].value) if names else "nothing"
    if name != PAGE and name_text != common_name(name, cell):
        text = f"it is for {name_text}, not for {common_name(name, cell)}"
        yield CertificateFinding("wrong", name, text, remedy)
    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, ValueError, TypeError):
        yield CertificateFinding("wrong", name, f"{signer}.pem here has not signed it", remedy)
    if name != PAGE and can_be_the_hub(certificate) != (name == HUB):
        yield CertificateFinding("wrong", name, _wrong_end(name, certificate), remedy)
    yield from _of_file(folder, name, certificate, now)


def _wrong_end(name: str, certificate: x509.Certificate) -> str:
    if name == HUB:
        return "it is valid for clients only: every client rejects a hub that shows it"
    ends = certificate.not_valid_after_utc
    return (
        f"it is of an older forcemesh and can stand in for the hub until {ends:%Y-%m-%d}; a new "
        "one cannot; if others may have this one, `forcemesh pki init --again` revokes it"
    )


def _of_file(
    folder: Path, name: str, certificate: x509.Certificate, now: dt.datetime
) -> Iterator[CertificateFinding]:
    is_authority = name == AUTHORITY
    remedy = "forcemesh pki init --again" if is_authority else REMEDY.format(name=name)
    key = folder / f"{name}.key"
    if key.exists() or not is_authority:
        yield from _of_key(key, name, certificate, remedy)
    ends = certificate.not_valid_after_utc
    remaining = f"{(ends - now).days} days left, until {ends:%Y-%m-%d}"
    if now < certificate.not_valid_before_utc:
        begins = certificate.not_valid_before_utc
        text = f"not valid before {begins:%Y-%m-%d %H:%M}: is this machine's clock right?"
        yield CertificateFinding("wrong", name, text, "set the clock")
    elif now >= ends:
        yield CertificateFinding("wrong", name, f"expired on {ends:%Y-%m-%d}", remedy)
    elif now >= ends - SOON:
        yield CertificateFinding("soon", name, remaining, remedy)
    else:
        yield CertificateFinding("good", name, remaining)


def _of_key(
    path: Path, name: str, certificate: x509.Certificate, remedy: str
) -> Iterator[CertificateFinding]:
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError) as error:
        yield CertificateFinding("wrong", name, f"{path.name}: no key: {error}", remedy)
        return
    if mode & OTHERS:
        text = f"{path.name} is readable by others (mode {mode:o}): it may be compromised"
        yield CertificateFinding("wrong", name, text, f"chmod 400 {path}; {remedy}")
    if key.public_key() != certificate.public_key():
        yield CertificateFinding("wrong", name, f"{path.name} is not the key of {name}.pem", remedy)

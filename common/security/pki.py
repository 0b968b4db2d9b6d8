"""Certificates of a cell's bus (X.509): an authority, one certificate per role and person.

Only the hub's certificate is valid for a server: TLS rejects a hub that shows another one.

The authority's key stays in the folder where it was made: its holder can impersonate any role.
Files are readable by their owner only, and are never overwritten without an explicit request.
"""

import datetime as dt
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from common.config.state_file import replace_file
from forcemesh.errors import DataError
from forcemesh.identity import AUTHORITY, HUB, PAGE, common_name

AUTHORITY_DAYS = 3650
CLOCK_SKEW = dt.timedelta(hours=1)  # between this machine and the others
ONLY_OWNER_READS = 0o400


@dataclass(frozen=True, slots=True)
class Pair:
    """A certificate and its key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def make_authority(cell: str, now: dt.datetime, *, of_page: bool = False) -> Pair:
    """Return a new authority, which only signs certificates.

    That of the panel's page is trusted by browsers but not on the bus: browsers store authorities
    for long and in many places, and what signs for the bus can impersonate the hub.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"forcemesh {'panel ' if of_page else ''}authority of {cell}")
    builder = _builder(name, name, key, now, days=AUTHORITY_DAYS, signs=True)
    return Pair(builder.sign(key, hashes.SHA256()), key)


def make_certificate(
    authority: Pair, name: str, cell: str, *, hosts: Sequence[str], days: int, now: dt.datetime
) -> Pair:
    """Return a certificate for a name of a cell, or for the panel's page.

    Args:
        authority: The signing authority.
        name: A name of forcemesh/identity.py. The hub's certificate is valid for both ends of a
            link, for a hub can connect to another hub; that of the page is valid for servers only,
            all others for clients only.
        cell: The cell of the name.
        hosts: Host names and addresses of hub or page; unused for other names.
        days: Validity [days].
        now: Present time.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    common = f"forcemesh panel page of {cell}" if name == PAGE else common_name(name, cell)
    issuer = authority.certificate.subject
    builder = _builder(_name(common), issuer, key, now, days=days, signs=False)
    ends = [] if name == PAGE else [ExtendedKeyUsageOID.CLIENT_AUTH]
    if name in (HUB, PAGE):
        ends.append(ExtendedKeyUsageOID.SERVER_AUTH)
        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    builder = builder.add_extension(x509.ExtendedKeyUsage(ends), critical=False)
    return Pair(builder.sign(authority.key, hashes.SHA256()), key)


def write_pair(folder: Path, name: str, pair: Pair, *, owner: tuple[int, int] | None) -> None:
    """Write both files atomically, readable by their owner only.

    Args:
        folder: Created if missing, closed to others.
        name: Base name of the files.
        pair: Certificate and key.
        owner: User and group of the files; None: those of this process.

    Raises:
        DataError: They cannot be written.
    """
    key = pair.key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    _write(folder / f"{name}.key", key, owner)
    _write(folder / f"{name}.pem", pair.certificate.public_bytes(serialization.Encoding.PEM), owner)


def copy_certificate(
    source: Path, target: Path, name: str, *, owner: tuple[int, int] | None
) -> None:
    """Copy a certificate, without its key, to another folder. Raise DataError on failure."""
    certificate = read_certificate(source / f"{name}.pem")
    _write(target / f"{name}.pem", certificate.public_bytes(serialization.Encoding.PEM), owner)


def read_authority(folder: Path, name: str = AUTHORITY) -> Pair:
    """Return the authority of a folder.

    Raises:
        DataError: It is missing or unreadable; names the remedy.
    """
    certificate = read_certificate(folder / f"{name}.pem")
    path = folder / f"{name}.key"
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError) as error:
        raise DataError(
            f"{path}: the authority's key cannot be read ({error}); issue it where `forcemesh pki "
            "init` was run: the key stays there"
        ) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise DataError(f"{path}: not a key made by `forcemesh pki init`")
    return Pair(certificate, key)


def can_be_the_hub(certificate: x509.Certificate) -> bool:
    """Return whether TLS accepts a certificate from a server, also one without a stated usage."""
    try:
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return True
    anything = ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE
    return ExtendedKeyUsageOID.SERVER_AUTH in usage or anything in usage


def read_certificate(path: Path) -> x509.Certificate:
    """Return the certificate in a file. Raise DataError if there is none."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: no certificate: {error}") from error


def _write(path: Path, data: bytes, owner: tuple[int, int] | None) -> None:
    replace_file(path, data.decode("ascii"), mode=ONLY_OWNER_READS, owner=owner)


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, now: dt.datetime,
    *, days: int, signs: bool,
) -> x509.CertificateBuilder:  # fmt: skip
    """Return the common part of a certificate; `signs`: it is that of an authority."""
    usage = x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    basic = x509.BasicConstraints(ca=signs, path_length=0 if signs else None)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SKEW)
        .not_valid_after(now + dt.timedelta(days=days))
        .add_extension(basic, critical=True)
        .add_extension(usage, critical=True)
    )

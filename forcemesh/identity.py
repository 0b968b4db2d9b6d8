"""Identity of a process on a networked bus: certificate files, and refusal of open endpoints.

Every name on the bus has two files, `<name>.pem` and `<name>.key`, and the authority has `ca.pem`.
Names are the roles and helpers of forcemesh/topics.py, the people `operator` and `monitor`, and the
`panel`, which acts for its user; the common name is `<name>.<cell>`, so that a certificate of one
cell is not valid in another.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from forcemesh.connection import Reachable
from forcemesh.errors import SetupError
from forcemesh.published_ports import hub_stays_here, is_loopback
from forcemesh.topics import CLIENT, HELPERS, ROLES

FOLDER_VARIABLE = "FORCEMESH_PKI"
NAME_VARIABLE = "FORCEMESH_NAME"
DEFAULT_FOLDER = "~/.config/forcemesh/pki"
AUTHORITY = "ca"
HUB = "hub"
# Of the panel's page, for browsers: an authority that is not trusted on the bus.
PAGE_AUTHORITY, PAGE = "panel-ca", "panel-page"
OPERATOR, MONITOR = "operator", "monitor"
PANEL = "panel"
PEOPLE = (OPERATOR, MONITOR, PANEL)
NAMES = (*ROLES, *HELPERS, *PEOPLE)
ENCRYPTED = ("tls", "quic")
IN_THE_KERNEL = ("unixsock-stream", "unixpipe", "vsock")


def common_name(name: str, cell: str) -> str:
    """Return the common name of a certificate, by which the hub grants access."""
    return f"{name}.{cell}"


def is_encrypted(endpoint: str) -> bool:
    """Return whether an endpoint requires certificates."""
    return endpoint.partition("/")[0] in ENCRYPTED


def stays_here(endpoint: str) -> bool:
    """Return whether an endpoint can only be reached from this machine."""
    scheme, _, where = endpoint.partition("/")
    if scheme in IN_THE_KERNEL:
        return True
    host = where.partition("?")[0].partition("#")[0].rpartition(":")[0]
    return is_loopback(host) or hub_stays_here(host)


def refuse_in_the_clear(cell: Reachable, endpoint: str) -> None:
    """Refuse a bus that is reachable by other machines without certificates.

    Raises:
        SetupError: The endpoint is reachable from outside, is not encrypted, and the cell file does
            not permit this explicitly.
    """
    if is_encrypted(endpoint) or stays_here(endpoint) or cell.bus.insecure:
        return
    secure = f"tls/{endpoint.partition('/')[2]}"
    raise SetupError(
        f"refused: {endpoint} is reachable from outside this machine without authentication; "
        f"use {secure} with `forcemesh pki init`, or write `insecure: true` in the section `bus` "
        "of the cell file: any client that reaches it may then move the arm"
    )


def folder_of(cell: Reachable) -> Path:
    """Return the folder of the certificates: from the environment, else from the cell file."""
    moved = os.environ.get(FOLDER_VARIABLE)
    named = None if cell.bus.tls is None else cell.bus.tls.folder
    return Path(moved or named or f"{DEFAULT_FOLDER}/{cell.cell}").expanduser()


@dataclass(frozen=True, slots=True)
class Identity:
    """A name on the bus, with its certificate files."""

    name: str
    folder: Path

    @property
    def authority(self) -> Path:
        """Return the certificate file of the authority."""
        return self.folder / f"{AUTHORITY}.pem"

    @property
    def certificate(self) -> Path:
        """Return the certificate file."""
        return self.folder / f"{self.name}.pem"

    @property
    def key(self) -> Path:
        """Return the private key file."""
        return self.folder / f"{self.name}.key"

    def settings(self) -> dict[str, object]:
        """Return the Zenoh settings for either end of a link (mutual TLS)."""
        return {
            "root_ca_certificate": str(self.authority),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
            "listen_certificate": str(self.certificate),
            "listen_private_key": str(self.key),
            "connect_certificate": str(self.certificate),
            "connect_private_key": str(self.key),
        }


def identity_of(cell: Reachable, role: str) -> Identity:
    """Return the identity of a role; of a client: from the environment, else the first available.

    Raises:
        SetupError: A file is missing or unreadable; names the remedy.
    """
    folder = folder_of(cell)
    name = _client_name(folder) if role == CLIENT else role
    identity = Identity(name, folder)
    for path in (identity.authority, identity.certificate, identity.key):
        try:
            path.read_bytes()
        except FileNotFoundError:
            raise SetupError(
                f"no certificate for {name}: {path} is missing; `forcemesh pki init --cell FILE` "
                f"makes all of a cell, `forcemesh pki issue {name} --cell FILE` only this one, "
                f"{FOLDER_VARIABLE} names their folder"
            ) from None
        except OSError as error:
            raise SetupError(
                f"no certificate for {name}: {path} cannot be read ({error.strerror}); make it "
                "readable by the user that runs this process"
            ) from None
    return identity


def _client_name(folder: Path) -> str:
    """Return the name that a client uses; in a container that of the container's role."""
    names = (*PEOPLE, *ROLES, *HELPERS)
    present = (name for name in names if (folder / f"{name}.key").exists())
    return os.environ.get(NAME_VARIABLE) or next(present, OPERATOR)

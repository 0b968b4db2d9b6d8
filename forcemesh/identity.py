"""Who a process is on a bus that leaves this machine: its certificate, and what it must not do.

Every name on the bus has two files, `<name>.pem` and `<name>.key`, beside the authority's `ca.pem`.
Names are the roles and helpers of forcemesh/topics.py, the people `operator` and `monitor`, and the
`panel`, which asks for whoever sits at it; the certificate says `<name>.<cell>`, so that what
belongs to one cell opens nothing in another.
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
# Of the panel's page, for browsers: an authority that nobody on the bus trusts.
PAGE_AUTHORITY, PAGE = "panel-ca", "panel-page"
OPERATOR, MONITOR = "operator", "monitor"
PANEL = "panel"
PEOPLE = (OPERATOR, MONITOR, PANEL)
NAMES = (*ROLES, *HELPERS, *PEOPLE)
ENCRYPTED = ("tls", "quic")
IN_THE_KERNEL = ("unixsock-stream", "unixpipe", "vsock")


def common_name(name: str, cell: str) -> str:
    """Return what a certificate says: by this the hub tells who may say what."""
    return f"{name}.{cell}"


def is_encrypted(endpoint: str) -> bool:
    """Tell whether an endpoint asks for certificates."""
    return endpoint.partition("/")[0] in ENCRYPTED


def stays_here(endpoint: str) -> bool:
    """Tell whether nobody outside this machine can reach an endpoint."""
    scheme, _, where = endpoint.partition("/")
    if scheme in IN_THE_KERNEL:
        return True
    host = where.partition("?")[0].partition("#")[0].rpartition(":")[0]
    return is_loopback(host) or hub_stays_here(host)


def refuse_in_the_clear(cell: Reachable, endpoint: str) -> None:
    """Keep a bus that others can reach from being used without certificates.

    Raises:
        SetupError: The endpoint leaves this machine, is not encrypted, and the cell file does not
            say in so many words that this is wanted.
    """
    if is_encrypted(endpoint) or stays_here(endpoint) or cell.bus.insecure:
        return
    secure = f"tls/{endpoint.partition('/')[2]}"
    raise SetupError(
        f"refused: {endpoint} is reached from outside this machine and asks nobody who he is; "
        f"use {secure} with `forcemesh pki init`, or write `insecure: true` in the section `bus` "
        "of the cell file, then anybody in reach may move the arm"
    )


def folder_of(cell: Reachable) -> Path:
    """Return where the certificates are: the environment may move it."""
    moved = os.environ.get(FOLDER_VARIABLE)
    named = None if cell.bus.tls is None else cell.bus.tls.folder
    return Path(moved or named or f"{DEFAULT_FOLDER}/{cell.cell}").expanduser()


@dataclass(frozen=True, slots=True)
class Identity:
    """A name on the bus and the files that prove it."""

    name: str
    folder: Path

    @property
    def authority(self) -> Path:
        """Return the file that all trust."""
        return self.folder / f"{AUTHORITY}.pem"

    @property
    def certificate(self) -> Path:
        """Return the file that is shown."""
        return self.folder / f"{self.name}.pem"

    @property
    def key(self) -> Path:
        """Return the file that is kept."""
        return self.folder / f"{self.name}.key"

    def settings(self) -> dict[str, object]:
        """Return what Zenoh is told of it, for either end of a link; both ends show theirs."""
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
    """Return who a role is. A client is who the environment says, else the first one it can be.

    Raises:
        SetupError: A file is missing or cannot be read; the remedy is named.
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
                f"makes all of a cell, `forcemesh pki issue {name} --cell FILE` one, "
                f"{FOLDER_VARIABLE} says where they are"
            ) from None
        except OSError as error:
            raise SetupError(
                f"no certificate for {name}: {path} cannot be read ({error.strerror}); give it to "
                "the user that runs this process"
            ) from None
    return identity


def _client_name(folder: Path) -> str:
    """Return the person that a client speaks for; in a container it is the container's own role."""
    named = os.environ.get(NAME_VARIABLE)
    if named:
        return named
    there = [name for name in (*PEOPLE, *ROLES, *HELPERS) if (folder / f"{name}.key").exists()]
    return there[0] if there else OPERATOR

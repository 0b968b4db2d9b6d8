"""TLS of the panel's page: beyond this machine there is no other way in.

The certificate is of an authority of its own, `panel-ca`, which a person lets their browser trust.
Nobody on the bus trusts it, and it can be given to every phone of a lab.
"""

import ssl
from pathlib import Path

from common.config.cell import Cell
from forcemesh.errors import ForcemeshError
from forcemesh.identity import PAGE, folder_of
from services.panel.access import Door


def context_of(cell: Cell, door: Door) -> ssl.SSLContext | None:
    """Return what the panel listens with, None where it is for this machine alone.

    Raises:
        ForcemeshError: Others reach it and there is no certificate, or none that can be used.
    """
    if not door.is_encrypted:
        return None
    folder = folder_of(cell)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(folder / f"{PAGE}.pem", folder / f"{PAGE}.key")
    except (OSError, ssl.SSLError) as error:
        raise ForcemeshError(refusal(door, folder, error)) from None
    return context


def refusal(door: Door, folder: Path, error: Exception) -> str:
    """Say what is missing and how to have it."""
    what = "is missing" if isinstance(error, FileNotFoundError) else f"cannot be used ({error})"
    return (
        f"refused: on {door.reached_at} the token would pass in the clear, and {folder}/{PAGE}.pem "
        f"or .key {what}: `forcemesh pki issue {PAGE} --host NAME --cell FILE` makes them, where "
        "`forcemesh pki init` was run; or let the panel listen on 127.0.0.1 and come through SSH "
        "or a proxy on this machine"
    )

"""TLS of the panel's page: required wherever other machines reach the panel.

The certificate is issued by a separate authority, `panel-ca`, which is installed in the browsers.
The bus does not trust it, so it can be distributed to every phone of a lab.
"""

import ssl
from pathlib import Path

from common.config.cell import CellConfig
from forcemesh.errors import ForcemeshError
from forcemesh.identity import PAGE, folder_of
from services.panel.access import Door


def context_of(cell: CellConfig, door: Door) -> ssl.SSLContext | None:
    """Return the TLS context of the panel, None when only this machine reaches it.

    Raises:
        ForcemeshError: Other machines reach it and the certificate is missing or unusable.
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
    """Return the refusal: the missing or unusable certificate, and the remedy."""
    what = "is missing" if isinstance(error, FileNotFoundError) else f"cannot be used ({error})"
    return (
        f"refused: on {door.reached_at} the token would be sent unencrypted, and "
        f"{folder}/{PAGE}.pem or .key {what}: run `forcemesh pki issue {PAGE} --host NAME --cell "
        "FILE` where `forcemesh pki init` was run; or let the panel listen on 127.0.0.1 and use "
        "SSH or a proxy on this machine"
    )

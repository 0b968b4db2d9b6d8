"""Content-Security-Policy of the page: its own scripts and this panel's address only. Pure.

Second barrier behind `services.panel.markup`: if foreign text became an element, it could run,
frame and send nothing. Every own script carries a nonce drawn for each reply; an injected script
has none.
"""

import re

from forcemesh.errors import ForcemeshError

NONCE = "nonce-of-this-answer"  # placeholder, replaced when the page is sent
# viser's front end unpacks its code, its workers and its styles from the page, and evaluates some.
POLICY = (
    "default-src 'self' data: blob:; script-src 'nonce-{nonce}' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' {sockets}data: blob:; "
    "worker-src 'self' blob: data:; frame-src 'none'; object-src 'none'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
)
UNPACKS = 'e.type="module";'  # viser's script passes its code to a script that it creates
NETLOC = re.compile(r"[A-Za-z0-9.\-]+(:[0-9]+)?|\[[0-9a-fA-F:]+\](:[0-9]+)?")


def policy(nonce: str, asked: str) -> str:
    """Return the header of a page with this nonce, requested under a `Host`.

    For some browsers 'self' does not include the websocket of the same address.
    """
    sockets = f"ws://{asked} wss://{asked} " if NETLOC.fullmatch(asked) else ""
    return POLICY.format(nonce=nonce, sockets=sockets)


def with_nonces(text: str) -> str:
    """Return the page with the nonce in all of its scripts."""
    return text.replace("<script", f'<script nonce="{NONCE}"')


def with_nonce_unpacked(text: str) -> str:
    """Return viser's page, changed so that its script passes the nonce to the unpacked code.

    Raises:
        ForcemeshError: This version of viser unpacks its page differently.
    """
    if text.count(UNPACKS) != 1:
        raise ForcemeshError(
            "refused: this version of viser loads its page in a form that the panel's "
            "Content-Security-Policy does not support; use a version that pyproject.toml names"
        )
    return text.replace(UNPACKS, f'{UNPACKS}e.nonce="{NONCE}";')

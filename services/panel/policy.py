"""What a browser may let the page do: run its own scripts, call this panel, and nothing else. Pure.

The second lock behind `services.panel.markup`: were foreign text ever to become an element, it
could run nothing, frame nothing and send nothing. Every script of ours carries a number that is
drawn anew
for each answer; a script that came in with a text cannot know it.
"""

import re

from forcemesh.errors import ForcemeshError

NONCE = "nonce-of-this-answer"  # stands in a page until it is sent
# viser's front end unpacks its code, its workers and its styles from the page, and evaluates some.
POLICY = (
    "default-src 'self' data: blob:; script-src 'nonce-{nonce}' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' {sockets}data: blob:; "
    "worker-src 'self' blob: data:; frame-src 'none'; object-src 'none'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
)
UNPACKS = 'e.type="module";'  # viser's own script hands its code to a script that it makes
NETLOC = re.compile(r"[A-Za-z0-9.\-]+(:[0-9]+)?|\[[0-9a-fA-F:]+\](:[0-9]+)?")


def policy(nonce: str, asked: str) -> str:
    """Return the header of a page with this nonce, asked for under a `Host`.

    Some browsers do not count the websocket of a page's own address as its own.
    """
    sockets = f"ws://{asked} wss://{asked} " if NETLOC.fullmatch(asked) else ""
    return POLICY.format(nonce=nonce, sockets=sockets)


def with_nonces(text: str) -> str:
    """Return a page all of whose scripts carry the nonce."""
    return text.replace("<script", f'<script nonce="{NONCE}"')


def with_nonce_unpacked(text: str) -> str:
    """Return viser's page, whose script hands its nonce on to the code that it unpacks.

    Raises:
        ForcemeshError: This version of viser unpacks itself in another way.
    """
    if text.count(UNPACKS) != 1:
        raise ForcemeshError(
            "refused: this version of viser starts its page in a way that the panel's "
            "Content-Security-Policy does not know; use one that pyproject.toml names"
        )
    return text.replace(UNPACKS, f'{UNPACKS}e.nonce="{NONCE}";')

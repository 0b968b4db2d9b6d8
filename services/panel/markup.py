"""HTML of ours with text of others in it: the one function that lets foreign text into a page.

A reason, a name, a hash from the bus is written by any process that may publish, and a browser
takes markup in it for ours: an element, a frame, a script. So a page is made of `Html` alone, and
`Html` is made by `html`, which escapes everything that is not `Html` already.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True, slots=True)
class Html:
    """HTML in which every foreign text is escaped."""

    source: str

    def __str__(self) -> str:
        return self.source


def html(template: str, *parts: object) -> Html:
    """Return a template of ours with its `{}` filled: Html as it is, everything else as text.

    The template is a literal, and an attribute's value stands in quotes in it; a test sweeps that.
    """
    return Html(template.format(*(_source(part) for part in parts)))


def joined(parts: Iterable[Html], between: str = "") -> Html:
    """Return pieces one after the other, with text of ours between them."""
    return Html(escape(between).join(part.source for part in parts))


def _source(part: object) -> str:
    return part.source if isinstance(part, Html) else escape(str(part))

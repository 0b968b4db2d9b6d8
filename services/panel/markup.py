"""HTML with escaped foreign text: protection of the pages against injection.

A reason, a name, a hash from the bus is written by any process that may publish, and a browser
would execute markup in it: an element, a frame, a script. A page therefore consists of `Html` only,
and only this module makes `Html`: it escapes everything that is not yet `Html`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from string import Template


@dataclass(frozen=True, slots=True)
class Html:
    """HTML in which every foreign text is escaped."""

    source: str

    def __str__(self) -> str:
        return self.source


def html(template: str, *parts: object) -> Html:
    """Return a template with its `{}` filled: Html unchanged, everything else escaped.

    The template is a literal with quoted attribute values; a test checks every call.
    """
    return Html(template.format(*(_source(part) for part in parts)))


def joined(parts: Iterable[Html], between: str = "") -> Html:
    """Return the parts joined by an escaped separator."""
    return Html(escape(between).join(part.source for part in parts))


def filled_page(package: str, name: str, **parts: object) -> Html:
    """Return a page of a package's `templates` with its `$names` filled as `html` does."""
    sources = {part: _source(value) for part, value in parts.items()}
    return Html(Template(template(package, name)).substitute(sources))


def template(package: str, name: str) -> str:
    """Return the text of a file in a package's `templates`."""
    return files(package).joinpath("templates", name).read_text(encoding="utf-8")


def paragraphs(*lines: Html | str) -> Html:
    """Return each line as a paragraph; plain strings are escaped."""
    return joined(html("<p>{}</p>", line) for line in lines)


def _source(part: object) -> str:
    return part.source if isinstance(part, Html) else escape(str(part))

"""HTML with escaped foreign text: protection of the pages against injection.

A reason, a name, a hash from the bus is written by any process that may publish, and a browser
would execute markup in it: an element, a frame, a script. A page therefore consists of `Html` only,
and only this module makes `Html`: it escapes everything that is not yet `Html`.
"""

from collections.abc import Iterable
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup as Html
from markupsafe import escape

__all__ = ["Html", "filled_page", "html", "joined", "paragraphs", "template"]


def html(template: str, *parts: object) -> Html:
    """Return a template with its `{}` filled: Html unchanged, everything else escaped.

    The template is a literal with quoted attribute values; a test checks every call.
    """
    return Html(template).format(*parts)  # noqa: S704 - of literals only


def joined(parts: Iterable[Html], between: str = "") -> Html:
    """Return the parts joined by an escaped separator."""
    return escape(between).join(parts)


def filled_page(package: str, name: str, **parts: object) -> Html:
    """Return a page of a package's `templates` with its names filled as `html` does.

    Raises jinja2.UndefinedError when the page has a name that is not given.
    """
    pages = Environment(loader=PackageLoader(package), autoescape=True, undefined=StrictUndefined)
    return Html(pages.get_template(name).render(parts))  # noqa: S704 - escaped by the template


def template(package: str, name: str) -> str:
    """Return the text of a file in a package's `templates`."""
    return files(package).joinpath("templates", name).read_text(encoding="utf-8")


def paragraphs(*lines: Html | str) -> Html:
    """Return each line as a paragraph; plain strings are escaped."""
    return joined(html("<p>{}</p>", line) for line in lines)

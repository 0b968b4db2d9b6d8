"""Foreign text in the panel's HTML: one function escapes it, and no other code does."""

import ast
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.panel.markup import html, joined
from tools.tree import production_files

ROOT = Path(__file__).parents[4]
SOURCES = production_files()
TAG = re.compile(r"</?[a-zA-Z][a-zA-Z0-9]*[ >/]")
NUMBER = re.compile(r"[+,0-9.]*[dfgex]$")
UNQUOTED = re.compile(r"=\s*\{|<[^>]*\{\}[^>\"]*(?<!\")>")
PROSE = "services/panel/viewer.py"
# The one file that may call each; Markdown renders raw HTML, so none may.
CALLED_IN = {"add_markdown": "", "add_html": PROSE, "Html": "services/panel/markup.py"}
# Parts of f-strings with tags that are no foreign text, with the reason.
OURS = {
    "services/panel/server.py": {
        "head": "viser's page",
        "tail": "viser's page",
        "bar": "a file of ours",
        "NONCE": "of this file",
    },
    "sim/netft/protocol.py": {"name": "of this file", "lines": "made of escaped parts"},
}


class Elements(HTMLParser):
    """The elements of a page in order, and its text."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ""
        self.feed(str(source))
        self.close()

    def handle_starttag(self, tag, attrs):
        """Record a tag."""
        self.tags.append(tag + "".join(f" {name}" for name, _ in attrs))

    def handle_data(self, data):
        """Record a text."""
        self.text += data


@given(st.text(max_size=60))
def test_any_text_is_shown_literally_and_is_never_an_element(text):
    """This holds between tags and in an attribute; existing Html is not escaped again."""
    shown = text.replace("\r\n", "\n")
    inner = html('<b title="{}">{}</b>', text, text)
    found = Elements(html("<p>{}</p>", inner))
    assert (found.tags, found.text) == (["p", "b title"], shown)
    assert Elements(joined([inner, inner], text)).text == 3 * shown
    assert html("{}|{}", None, "{0}{}") == "None|{0}{}"  # braces in a text are no fields


# --- no other code makes HTML ---------------------------------------------------------------------


def refused(node: ast.AST, name: str) -> str:
    """Return the reason why a node may let foreign text into a page, empty when it does not."""
    called = ""
    if isinstance(node, ast.Call):
        called = getattr(node.func, "attr", getattr(node.func, "id", ""))
        template = node.args[0] if node.args else node
        if called in CALLED_IN and name != CALLED_IN[called]:
            return f"{called}: use Prose and services.panel.markup.html"
        if called == "html" and isinstance(node.func, ast.Name):
            text = ast.unparse(template)
            is_literal = isinstance(template, ast.Constant) or text.isupper() or text == "row"
            return "" if is_literal and not UNQUOTED.search(text) else "no literal, or no quotes"
    targets = node.targets if isinstance(node, ast.Assign) and name != PROSE else []
    if any(getattr(one, "attr", "") == "content" for one in targets):
        return "only Prose sets what a form shows"
    is_format = called == "format" and has_tag(getattr(node, "func", node))
    is_percent = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mod)
    if is_format or (is_percent and has_tag(node)):
        return "a template with tags is filled by services.panel.markup.html"
    if isinstance(node, ast.JoinedStr) and has_tag(node):
        parts = [one for one in node.values if isinstance(one, ast.FormattedValue)]
        return next((f"{each} is not escaped" for part in parts if (each := raw(part, name))), "")
    return ""


def has_tag(node: ast.AST) -> bool:
    """Return whether the literal text of a node has a tag."""
    inside = (one.value for one in ast.walk(node) if isinstance(one, ast.Constant))
    return bool(TAG.search("".join(str(each) for each in inside)))


def raw(part: ast.FormattedValue, name: str) -> str:
    """Return a part of an f-string that is neither escaped, a number nor listed."""
    spec = ast.unparse(part.format_spec)[2:-1] if part.format_spec is not None else ""
    source = ast.unparse(part.value)
    is_safe = "escape(" in source or NUMBER.fullmatch(spec) or source in OURS.get(name, {})
    return "" if is_safe else source


def test_one_function_alone_makes_html_of_foreign_text():
    """No Markdown; HTML in one place; templates are literals; f-strings with tags escape."""
    wrong = [
        f"{name}:{getattr(node, 'lineno', 0)}: {why}"
        for path in SOURCES
        for name in [str(path.relative_to(ROOT))]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (why := refused(node, name))
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "source",
    [
        'gui.add_markdown(f"**{state}**")',
        "gui.add_html(text)",
        "handle.content = text",
        "Html(reason)",
        "html(reason)",
        'html("<a href={}>", reason)',
        'f"<p>{reason}</p>"',
        '"<p>{}</p>".format(reason)',
        '"<p>%s</p>" % reason',
    ],
)
def test_the_check_detects_each_bypass(source):
    """This shows that the test above can fail."""
    assert any(refused(node, "services/panel/x.py") for node in ast.walk(ast.parse(source)))

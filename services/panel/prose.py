"""Text in the page's forms: what is shown there is `Html`, never Markdown.

viser's Markdown renders raw HTML, scripts included, makes links of anything that looks like one and
reads pictures off this machine's disk; nothing of that is wanted of a text from the bus.
"""

import viser

from services.panel.markup import Html, html, joined

NOTHING = html("")


class Prose:
    """A place for text in a form; it is sent to the browser only when it has changed."""

    def __init__(self, gui: viser.GuiApi, shown: Html = NOTHING) -> None:
        """Put it below what the form has so far."""
        self._shown = shown
        self._handle = gui.add_html(_framed(shown).source)

    def show(self, wanted: Html) -> None:
        """Show this from now on."""
        if wanted != self._shown:
            self._shown = wanted
            self._handle.content = _framed(wanted).source


def paragraphs(*lines: Html | str) -> Html:
    """Return lines, each a paragraph; a line of text is foreign."""
    return joined(html("<p>{}</p>", line) for line in lines)


def _framed(shown: Html) -> Html:
    return html('<div class="fm-prose">{}</div>', shown)

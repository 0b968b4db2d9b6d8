"""Text elements of the page's forms: escaped `Html`, never Markdown.

viser's Markdown renders raw HTML, scripts included, creates links and reads pictures from this
machine's disk; text from the bus must not do that.
"""

import viser

from services.panel.markup import Html, html, joined

NOTHING = html("")


class Prose:
    """Text element of a form; sent to the browser only when it has changed."""

    def __init__(self, gui: viser.GuiApi, shown: Html = NOTHING) -> None:
        """Append the element to the form."""
        self._shown = shown
        self._handle = gui.add_html(_framed(shown).source)

    def show(self, html: Html) -> None:
        """Replace the shown text."""
        if html != self._shown:
            self._shown = html
            self._handle.content = _framed(html).source


def paragraphs(*lines: Html | str) -> Html:
    """Return each line as a paragraph; plain strings are escaped."""
    return joined(html("<p>{}</p>", line) for line in lines)


def _framed(shown: Html) -> Html:
    return html('<div class="fm-prose">{}</div>', shown)

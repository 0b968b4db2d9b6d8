"""Call of a verb within the test's own process."""

from typer.testing import CliRunner, Result

from cli.__main__ import app


def run(*words: object, text: str = "") -> Result:
    """Call a verb; `text` is its standard input."""
    return CliRunner().invoke(app, [str(word) for word in words], input=text)

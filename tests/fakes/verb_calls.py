"""Call of a verb within the test's own process."""

from typer.testing import CliRunner, Result

from cli.__main__ import app


def run(*words: str) -> Result:
    """Call a verb."""
    return CliRunner().invoke(app, list(words))

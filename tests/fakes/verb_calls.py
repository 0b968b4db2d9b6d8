"""Call of a verb within the test's own process."""

from contextlib import contextmanager, nullcontext
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from cli.__main__ import app
from cli.context import one_line_errors
from cli.skills import force_session
from common.bus.configured_cell import ConfiguredCell


def run(*words: object, text: str = "") -> Result:
    """Call a verb; `text` is its standard input."""
    return CliRunner().invoke(app, [str(word) for word in words], input=text)


def call_verb(
    monkeypatch: pytest.MonkeyPatch, client: ConfiguredCell, on_progress: Any, *words: str
) -> Result:
    """Call a verb that works on a virtual cell; `on_progress` receives its progress."""

    @contextmanager
    def virtual(_named):
        with one_line_errors():
            yield client

    monkeypatch.setattr(force_session, "cell_of", virtual)
    monkeypatch.setattr(force_session, "progress_bar", lambda: nullcontext(on_progress))
    return run(*words)

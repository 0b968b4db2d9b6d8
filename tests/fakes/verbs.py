"""A verb of the command line, called on a virtual cell."""

from contextlib import contextmanager, nullcontext
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from cli.__main__ import app
from cli.context import one_line_errors
from cli.skills import force_session as at_work
from common.bus.configured_cell import ConfiguredCell


def call_verb(
    monkeypatch: pytest.MonkeyPatch, client: ConfiguredCell, on_progress: Any, *words: str
) -> Result:
    """Call a verb that works on a cell; `tell` receives its progress."""

    @contextmanager
    def virtual(_named):
        with one_line_errors():
            yield client

    monkeypatch.setattr(at_work, "cell_of", virtual)
    monkeypatch.setattr(at_work, "progress_bar", lambda: nullcontext(on_progress))
    return CliRunner().invoke(app, list(words))

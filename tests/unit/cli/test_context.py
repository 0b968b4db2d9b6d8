"""Conversion of every error to one line and an exit code."""

import pytest
import typer

from cli.context import (
    NEXT_STEP,
    NO_ANSWER,
    NO_REPLY_STEP,
    NOT_WELL,
    PART_STEP,
    REFUSED,
    USAGE,
    one_line_errors,
)
from forcemesh.errors import (
    BusError,
    ConfigError,
    DataError,
    ForcemeshError,
    LostError,
    NoHubError,
    RefusedError,
)

ROWS: tuple[tuple[Exception, int, str], ...] = (
    (ConfigError("cell.yaml", ["wrong"]), USAGE, "cell.yaml: wrong"),
    (DataError("a.mcap: no recording"), USAGE, "a.mcap: no recording"),
    (RefusedError("not_armed", "arm first"), REFUSED, "refused (not_armed): arm first"),
    (NoHubError("no hub: is the cell up?"), NO_ANSWER, f"no hub: is the cell up? {NEXT_STEP}\n"),
    (BusError("cannot listen on tcp/a:1"), NO_ANSWER, "cannot listen on tcp/a:1\n"),
    (LostError("no answer", ("arbiter",)), NO_ANSWER, f"no answer: {PART_STEP}\n"),
    (LostError("no silent role"), NO_ANSWER, f"no silent role: {NO_REPLY_STEP}\n"),
    (LostError("no answer", is_all=True), NO_ANSWER, f"no answer: {NEXT_STEP}\n"),
    (ForcemeshError("off by 3 mm"), NOT_WELL, "off by 3 mm"),
)


@pytest.mark.parametrize(("error", "code", "output"), ROWS, ids=[row[2] for row in ROWS])
def test_an_error_gives_its_message_and_exit_code(
    error: Exception, code: int, output: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message comes first; each kind of error has its exit code."""
    with pytest.raises(typer.Exit) as caught, one_line_errors():
        raise error
    assert caught.value.exit_code == code
    assert capsys.readouterr().err.startswith(output)

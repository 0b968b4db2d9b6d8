"""Fuzz target `cells`: a cell file loads and round-trips through its dump, or ConfigError."""

import tempfile
from functools import cache
from pathlib import Path

from common.config.load import dump_cell, load_cell
from forcemesh.errors import ConfigError

MAX_BYTES = 6000


@cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="forcemesh-fuzz-"))


def check(data: bytes) -> None:
    """Load bytes as a cell file; each mistake is listed with a message."""
    path = _folder() / "cell.yaml"
    path.write_bytes(data)
    try:
        cell = load_cell(path)
    except ConfigError as error:
        assert error.mistakes
        assert all(error.mistakes)
        return
    path.write_text(dump_cell(cell), encoding="utf-8")
    assert load_cell(path) == cell

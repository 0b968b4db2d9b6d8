"""Replacement of a file as a whole: after a kill or a power cut it is the old or the new one."""

import os
from contextlib import suppress
from pathlib import Path

from forcemesh.errors import DataError


def replace_file(path: Path, text: str) -> None:
    """Write a file that is state, such as a calibration; create its folder if needed.

    The data are on the disk before they get the file's name, and the name before this returns.
    A link stays a link. Raises DataError when the file cannot be written; it is then as before.
    """
    path = Path(os.path.realpath(path))
    draft = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with draft.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        except OSError:
            with suppress(OSError):
                draft.unlink()
            raise
        _sync_folder(path.parent)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

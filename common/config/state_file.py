"""Replacement of a file as a whole: after a kill or a power cut it is the old or the new one."""

import os
from contextlib import suppress
from pathlib import Path

from forcemesh.errors import DataError


def replace_file(
    path: Path, text: str, *, mode: int = 0o666, owner: tuple[int, int] | None = None
) -> None:
    """Write a file that is state, such as a calibration or a key; create its folder if needed.

    No other user can read a key, also during the write: mode and owner are those of its draft, and
    a new folder of files that others may not read is closed to them.
    The data are on the disk before they get the file's name, and the name before this returns.
    A link stays a link. Raises DataError when the file cannot be written; it is then as before.
    """
    path = Path(os.path.realpath(path))
    draft = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        is_open = mode & 0o077
        path.parent.mkdir(0o777 if is_open else 0o700, parents=True, exist_ok=True)
        draft.unlink(missing_ok=True)
        try:
            handle = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                if owner is not None:
                    os.fchown(file.fileno(), *owner)
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

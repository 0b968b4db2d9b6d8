"""Folder of recordings: file names, free space, and which recordings of stops are kept."""

import os
import re
import shutil
import sys
from collections import defaultdict
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from common.config.cell import CellConfig
from forcemesh.errors import DataError
from services.recorder.reading import RecordedFile

FOLDER_VARIABLE = "FORCEMESH_RECORDINGS"
PROJECT = Path(__file__).resolve().parents[2]
SUFFIX = ".mcap"
STOP = "STOP"  # in the name of a file that a stop triggered; user labels are lower case
LONGEST_LABEL = 60


def folder_of(cell: CellConfig) -> Path:
    """Return the folder of recordings: from the environment, else from the cell file."""
    return PROJECT / Path(os.environ.get(FOLDER_VARIABLE) or cell.recorder.folder).expanduser()


def safe_label(label: str) -> str:
    """Return a user label in characters that are safe in a file name."""
    return re.sub(r"[^a-z0-9_-]+", "-", label.lower()).strip("-")[:LONGEST_LABEL]


def stop_label(code: str) -> str:
    """Return the label of a stop; its code arrives over the bus and may be any text."""
    return f"{STOP}-{safe_label(code) or 'unknown'}"


def file_name(cell: str, wall_ns: int, label: str) -> str:
    """Return a portable file name that sorts by time, without number and suffix."""
    when = datetime.fromtimestamp(wall_ns / 1e9, UTC).strftime("%Y%m%dT%H%M%SZ")
    return "-".join(part for part in (cell, when, label) if part)


def new_file(folder: Path, name: str) -> Path:
    """Return an unused path in the folder; create the folder if needed."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = (folder / f"{name}-{number:02d}{SUFFIX}" for number in count(1))
    return next(path for path in paths if not path.exists())


def free_bytes(folder: Path) -> int:
    """Return the free space for an ordinary user at the folder or its nearest parent."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), Path("/"))
    return shutil.disk_usage(there).free


class Retention:
    """Recordings of one cell's stops in a folder: the newest of each code are kept.

    Cell, code and order are read from the recordings: a file name does not separate neighbouring
    cells, and the wall clock may have been set back.
    """

    def __init__(self, cell: CellConfig) -> None:
        """Read nothing yet."""
        self.unreadable: set[Path] = set()  # kept
        self._folder, self._cell = folder_of(cell), cell.cell
        self._about: dict[Path, dict[str, str]] = {}

    def of_code(self, code: str) -> list[tuple[int, list[Path]]]:
        """Return number and files of each recording of a stop's code, the oldest first.

        The number counts those of a code; it is 0 in older files.
        """
        found: dict[tuple[int, str], list[Path]] = defaultdict(list)
        for path in sorted(self._folder.glob(f"{self._cell}-*-{stop_label(code)}-*{SUFFIX}")):
            about = self._read(path)
            if (about.get("cell"), about.get("cause")) == (self._cell, code):
                number = about.get("number", "")
                key = int(number) if number.isdecimal() else 0, path.stem.rpartition("-")[0]
                found[key].append(path)
        return [(number, paths) for (number, _), paths in sorted(found.items())]

    def keep_newest(self, code: str, keep: int) -> None:
        """Remove all but the newest recordings of a code; a file that cannot be removed stays."""
        for _, paths in self.of_code(code)[:-keep]:
            for path in paths:
                try:
                    path.unlink(missing_ok=True)
                except OSError as error:
                    sys.stderr.write(f"{path}: cannot be removed: {error.strerror}\n")
                self._about.pop(path, None)

    def _read(self, path: Path) -> dict[str, str]:
        if path not in self._about and path not in self.unreadable:
            try:
                self._about[path] = RecordedFile(path).about
            except DataError as error:
                self.unreadable.add(path)
                sys.stderr.write(f"{error}; it is kept\n")
        return self._about.get(path, {})

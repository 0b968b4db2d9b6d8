"""Folder of recordings: file names and free space."""

import os
import re
import shutil
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

FOLDER_VARIABLE = "FORCEMESH_RECORDINGS"
PROJECT = Path(__file__).resolve().parents[2]
SUFFIX = ".mcap"
STOP = "STOP"  # in the name of a file that a stop triggered; user labels are lower case
LONGEST_LABEL = 60


def folder_of(named: str) -> Path:
    """Return the folder of recordings: from the environment, else from the cell file."""
    return PROJECT / Path(os.environ.get(FOLDER_VARIABLE) or named).expanduser()


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
    taken = {path.name for path in folder.glob(f"{name}-*{SUFFIX}")}
    names = (f"{name}-{number:02d}{SUFFIX}" for number in count(1))
    return folder / next(each for each in names if each not in taken)


def free_bytes(folder: Path) -> int:
    """Return the free space for an ordinary user at the folder or its nearest parent."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), Path("/"))
    return shutil.disk_usage(there).free

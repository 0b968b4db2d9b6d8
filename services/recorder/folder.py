"""Where recordings go: names, free space, and how many files of faults are kept."""

import os
import re
import shutil
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

FOLDER_VARIABLE = "FORCEMESH_RECORDINGS"
PROJECT = Path(__file__).resolve().parents[2]
SUFFIX = ".mcap"
STOP = "STOP"  # in the name of a file that a stop began; labels of people are in small letters
LONGEST_LABEL = 60


def folder_of(named: str) -> Path:
    """Return the folder of recordings: the environment's, else the cell file's, in the project."""
    return PROJECT / Path(os.environ.get(FOLDER_VARIABLE) or named).expanduser()


def safe_label(label: str) -> str:
    """Return what a person calls a recording as it may stand in a file's name."""
    return re.sub(r"[^a-z0-9_-]+", "-", label.lower()).strip("-")[:LONGEST_LABEL]


def file_name(cell: str, wall_ns: int, label: str) -> str:
    """Return a name that sorts by time and can be a file's anywhere; number and ending follow."""
    when = datetime.fromtimestamp(wall_ns / 1e9, UTC).strftime("%Y%m%dT%H%M%SZ")
    return "-".join(part for part in (cell, when, label) if part)


def new_file(folder: Path, name: str) -> Path:
    """Return a path in the folder at which there is nothing yet; make the folder if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    taken = {path.name for path in folder.glob(f"{name}-*{SUFFIX}")}
    names = (f"{name}-{number:02d}{SUFFIX}" for number in count(1))
    return folder / next(each for each in names if each not in taken)


def free_bytes(folder: Path) -> int:
    """Return the space that an ordinary user has left where the folder is or would be."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), Path("/"))
    return shutil.disk_usage(there).free


def forget_oldest(folder: Path, cell: str, label: str, keep: int) -> None:
    """Remove files that faults of one label began until there are no more than `keep`.

    Each label for itself: what stops an arm daily must not push out what happened once.
    """
    if not label.startswith(STOP):
        return
    found = sorted(folder.glob(f"{cell}-*-{label}-*{SUFFIX}"))
    for path in found[: max(len(found) - keep, 0)]:
        path.unlink(missing_ok=True)

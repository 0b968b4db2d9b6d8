"""Where recordings go: names, free space, and how many files of faults are kept."""

import os
import re
import shutil
from datetime import UTC, datetime
from pathlib import Path

FOLDER_VARIABLE = "FORCEMESH_RECORDINGS"
PROJECT = Path(__file__).resolve().parents[2]
SUFFIX = ".mcap"
FAULT = "fault"
LONGEST_LABEL = 60


def folder_of(named: str) -> Path:
    """Return the folder of recordings: the environment's, else the cell file's, in the project."""
    return PROJECT / Path(os.environ.get(FOLDER_VARIABLE) or named).expanduser()


def file_name(cell: str, wall_ns: int, label: str) -> str:
    """Return a name that sorts by time and can be a file's anywhere; it lacks number and ending."""
    when = datetime.fromtimestamp(wall_ns / 1e9, UTC).strftime("%Y%m%dT%H%M%SZ")
    safe = re.sub(r"[^A-Za-z0-9_-]+", "-", label).strip("-")[:LONGEST_LABEL]
    return "-".join(part for part in (cell, when, safe) if part)


def new_file(folder: Path, name: str) -> Path:
    """Return a path in the folder at which there is nothing yet; make the folder if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    path, number = folder / f"{name}{SUFFIX}", 2
    while path.exists():
        path, number = folder / f"{name}-{number}{SUFFIX}", number + 1
    return path


def free_bytes(folder: Path) -> int:
    """Return the space that an ordinary user has left where the folder is or would be."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), Path("/"))
    return shutil.disk_usage(there).free


def forget_oldest(folder: Path, cell: str, keep: int) -> None:
    """Remove files of a cell's faults until there are no more than `keep`."""
    found = sorted(folder.glob(f"{cell}-*-{FAULT}-*{SUFFIX}"))
    for path in found[: max(len(found) - keep, 0)]:
        path.unlink(missing_ok=True)

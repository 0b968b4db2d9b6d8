"""Folders of the project, for everything that reads its files."""

import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# What runs in a cell, in the order of the import contract: lowest layer first.
PRODUCTION = (
    "forcemesh",
    "controller",
    "common",
    "identification",
    "tuning",
    "services",
    "sim",
    "launch",
    "cli",
)
FOLDERS = (*PRODUCTION, "bench", "tests", "tools")
NOT_COPIED = shutil.ignore_patterns("pictures", ".*")


def production_files() -> list[Path]:
    """Return every Python file of production code, sorted."""
    return sorted(path for folder in PRODUCTION for path in (ROOT / folder).rglob("*.py"))


def copy_of_the_tree(folder: Path) -> None:
    """Copy what tests and commands read and write into a folder, which may be changed."""
    for path in ROOT.iterdir():
        if path.is_dir() and path.name in (*FOLDERS, "arms", "cells", "docs", "examples"):
            shutil.copytree(path, folder / path.name, ignore=NOT_COPIED)
        elif path.is_file():
            shutil.copy2(path, folder)
    (folder / ".venv").symlink_to(ROOT / ".venv")

"""Folders of the project, for everything that reads its files."""

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


def production_files() -> list[Path]:
    """Return every Python file of production code, sorted."""
    return sorted(path for folder in PRODUCTION for path in (ROOT / folder).rglob("*.py"))

"""Folders of the project, for everything that reads its files."""

import ast
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# What runs in a cell, in the order of the import contract: lowest layer first.
PRODUCTION = (
    "forcemesh",
    "controller",
    "common",
    "control",
    "identification",
    "tuning",
    "services",
    "sim",
    "launch",
    "cli",
)
FOLDERS = (*PRODUCTION, "bench", "tests", "tools")
WITH_PAGES = (*FOLDERS, "arms", "docs", "examples", "notebooks")
NOT_COPIED = shutil.ignore_patterns("pictures", ".*")


@dataclass(frozen=True)
class Module:
    """Python file with its parsed source."""

    name: str
    path: Path

    @cached_property
    def text(self) -> str:
        """The source."""
        return self.path.read_text(encoding="utf-8")

    @cached_property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.text.splitlines())

    @cached_property
    def tree(self) -> ast.Module:
        """The parsed source."""
        return ast.parse(self.text, filename=str(self.path))

    def imports(self, known: dict[str, "Module"]) -> set[str]:
        """Return the known modules that this one imports, also under TYPE_CHECKING."""
        found = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                found |= {name if name in known else node.module for name in inner}
        return (found & known.keys()) - {self.name}


def modules(root: Path = ROOT, folders: tuple[str, ...] = PRODUCTION) -> dict[str, Module]:
    """Return the modules of folders by dotted name, sorted by path."""
    found = {}
    for path in sorted(path for folder in folders for path in (root / folder).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = Module(name, path)
    return found


def production_files() -> list[Path]:
    """Return every Python file of production code, sorted."""
    return [module.path for module in modules().values()]


def pages(root: Path = ROOT) -> list[Path]:
    """Return every page, those of the top level first."""
    inner = (path for folder in WITH_PAGES for path in (root / folder).rglob("*.md"))
    return [*sorted(root.glob("*.md")), *sorted(inner)]


def copy_of_the_tree(folder: Path) -> None:
    """Copy what tests and commands read and write into a folder, which may be changed."""
    for path in ROOT.iterdir():
        if path.is_dir() and path.name in (*FOLDERS, "arms", "cells", "docs", "examples"):
            shutil.copytree(path, folder / path.name, ignore=NOT_COPIED)
        elif path.is_file():
            shutil.copy2(path, folder)
    (folder / ".venv").symlink_to(ROOT / ".venv")

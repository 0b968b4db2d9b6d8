"""docs/how-to-add.md: each worked example applies, touches few files, and passes its own tests."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools.tree import ROOT, copy_of_the_tree

PAGE = (ROOT / "docs" / "how-to-add.md").read_text(encoding="utf-8")
PATCHES = ROOT / "docs" / "how-to-add"
# Files that an addition may change beside its test and its pages; a folder of arms/ counts once.
MOST_FILES = {"sensor": 2, "arm": 2, "law": 2, "topic": 3, "packet-command": 4, "limit": 4,
              "role": 4, "skill": 1}  # fmt: skip

each_example = pytest.mark.parametrize("name", MOST_FILES)


def commands_of(name: str) -> list[str]:
    """Return the command lines of the section that applies a patch."""
    sections = (re.findall(r"^    (\S.*)$", part, re.MULTILINE) for part in PAGE.split("\n## "))
    (lines,) = (lines for lines in sections if f"git apply docs/how-to-add/{name}.diff" in lines)
    return lines


def changed_files(name: str) -> list[str]:
    """Return the files of a patch."""
    text = (PATCHES / f"{name}.diff").read_text(encoding="utf-8")
    return re.findall(r"^diff --git a/(\S+) b/\1$", text, re.MULTILINE)


def is_beside(path: str) -> bool:
    """Return whether a file is a test or a page."""
    return path.startswith(("tests/", "docs/")) or path.endswith("README.md")


@each_example
def test_an_addition_touches_few_files(name: str) -> None:
    """Beside its test and its pages; and the page names each of them, or its folder."""
    files = {path for path in changed_files(name) if not is_beside(path)}
    assert any(path.startswith("tests/") for path in changed_files(name))
    for path in files:
        assert path in PAGE or f"{path.rpartition('/')[0]}/" in PAGE, path
    assert len({re.sub(r"^(arms/\w+)/.*", r"\1", path) for path in files}) <= MOST_FILES[name]


@each_example
def test_the_tests_that_a_section_names_exist_or_come_with_its_patch(name: str) -> None:
    """The commands themselves run nightly."""
    named = re.findall(r"tests/[\w/]+\.py", " ".join(commands_of(name)))
    assert named or name == "skill"
    assert all((ROOT / path).is_file() or path in changed_files(name) for path in named)


def test_every_patch_is_on_the_page() -> None:
    """And no other."""
    assert {path.stem for path in PATCHES.glob("*.diff")} == set(MOST_FILES)


@pytest.mark.long
@each_example
def test_the_commands_of_the_page_pass(name: str, tmp_path: Path) -> None:
    """On a copy of the tree: the patch applies, pages are written anew, its tests pass."""
    copy_of_the_tree(tmp_path)
    for command in commands_of(name):
        own = {"PYTHONPATH": str(tmp_path), "GIT_CEILING_DIRECTORIES": str(tmp_path.parent)}
        done = subprocess.run(
            in_copy(command),
            cwd=tmp_path,
            env=os.environ | own,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"


def in_copy(command: str) -> list[str]:
    """Return the words of a command: no set-up, and tests one after the other."""
    made = re.fullmatch(r'make test ARGS="(.*)"', command)
    if made is None:
        return command.replace("make ", "make --assume-old=setup ").split()
    options = ("-q", "-n", "0", "-p", "no:cacheprovider", "-m", "not (realtime or processes)")
    return [sys.executable, "-m", "pytest", *options, *made[1].split()]

"""Check of the figures in README.md and docs: written by a command, or reviewed by a person.

Measured results are in blocks between two marks. The command that writes a block stamps it with
the commit, the day and a checksum of the text, so that a changed figure is detected. Figures
outside of blocks (settings, limits, data of decisions) are listed in docs/figures.yaml, per page
in their order; `python -m tools.figures --list` rewrites that list, and its diff is reviewed.

`python -m tools.figures` reports mismatches; exit code 1 if there are any.
"""

import argparse
import hashlib
import re
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import zip_longest
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "docs" / "figures.yaml"
BLOCK = re.compile(
    r"<!-- measured (?P<name>[\w.-]+) by `(?P<command>[^`]+)` at (?P<commit>\w+), (?P<day>[-\d]+), "
    r"check (?P<sum>\w+) -->\n(?P<text>.*?)\n<!-- end of (?P=name) -->",
    re.DOTALL,
)
UNITS = "N·m|Nm|N/mm|N/m|N|mm/s|mm|ms|us|%|tau|degrees|deg|times faster|times"
FIGURE = re.compile(rf"(?<![\w.,])\d[\d ]*(?:\.\d+)?[  ]?(?:{UNITS})(?![\w/])")


def check_sum(text: str) -> str:
    """Return the checksum of a text for its mark."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()[:12]


def block(name: str, text: str, command: str, root: Path = ROOT) -> str:
    """Return a text with its marks, measured now at the checked-out commit."""
    words = ["git", "-C", str(root), "rev-parse", "--short=10", "HEAD"]
    commit = subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    text = text.strip("\n")
    stamp = f"at {commit}, {datetime.now(UTC):%Y-%m-%d}, check {check_sum(text)}"
    return f"<!-- measured {name} by `{command}` {stamp} -->\n{text}\n<!-- end of {name} -->"


def as_block_page(name: str, page: str, command: str) -> str:
    """Return a generated page, all of it except the title in a block."""
    title, _, rest = page.partition("\n")
    return f"{title}\n\n{block(name, rest, command)}\n"


def replace_block(page: Path, name: str, text: str, command: str) -> None:
    """Write a block into a page, replacing the one with this name.

    Raises:
        ValueError: The page has no such block.
    """
    old = page.read_text(encoding="utf-8")
    for found in BLOCK.finditer(old):
        if found["name"] == name:
            new = block(name, text, command)
            page.write_text(old[: found.start()] + new + old[found.end() :], encoding="utf-8")
            return
    raise ValueError(f"{page.name} has no block `{name}`")


def pages(root: Path = ROOT) -> list[Path]:
    """Return README and the pages of docs."""
    return [root / "README.md", *sorted((root / "docs").glob("*.md"))]


def figures(text: str) -> list[str]:
    """Return the figures outside of blocks, in their order."""
    return [" ".join(found.split()) for found in FIGURE.findall(BLOCK.sub("", text))]


def listed(root: Path = ROOT) -> dict[str, list[str]]:
    """Return the reviewed figures by page."""
    found = {str(page.relative_to(root)): figures(page.read_text("utf-8")) for page in pages(root)}
    return {page: each for page, each in found.items() if each}


def mismatches(root: Path = ROOT) -> Iterator[str]:
    """Yield the location of every figure that is neither generated nor reviewed."""
    reviewed = yaml.safe_load((root / "docs" / LIST.name).read_text(encoding="utf-8")) or {}
    for page in pages(root):
        text, name = page.read_text(encoding="utf-8"), str(page.relative_to(root))
        for found in BLOCK.finditer(text):
            if check_sum(found["text"]) != found["sum"]:
                yield f"{name}: block {found['name']} was changed by hand: {found['command']}"
        if text.count("<!-- measured ") != len(BLOCK.findall(text)):
            yield f"{name}: malformed mark `<!-- measured`"
        now, read = figures(text), reviewed.get(name, [])
        if now != read:
            yield f"{name}: {_first_difference(now, read)}"
    for page_name in reviewed.keys() - {str(page.relative_to(root)) for page in pages(root)}:
        yield f"{page_name}: in docs/{LIST.name}, but there is no such page"


def _first_difference(now: list[str], read: list[str]) -> str:
    for number, (here, there) in enumerate(zip_longest(now, read, fillvalue="nothing"), start=1):
        if here != there:
            return f"figure {number} is {here}, docs/{LIST.name} has {there}"
    return ""


def main() -> int:
    """Check the pages, or rewrite the list."""
    parser = argparse.ArgumentParser(prog="python -m tools.figures", description=__doc__)
    parser.add_argument("--list", action="store_true", help="write docs/figures.yaml: review it")
    if parser.parse_args().list:
        head = "# Figures outside of measured blocks, in their order; see tools/figures.py.\n"
        text = yaml.safe_dump(listed(), allow_unicode=True, width=100, default_flow_style=None)
        LIST.write_text(head + text, encoding="utf-8")
        return 0
    found = list(mismatches())
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

"""The front page says what the code says."""

import re
from pathlib import Path

from tools.bus_page import README, ROOT, bus_table


def test_the_bus_table_is_the_one_in_the_code():
    """`make readme` writes it from forcemesh/topics.py; nobody edits it by hand."""
    assert bus_table() in README.read_text(encoding="utf-8")


def test_every_link_and_picture_is_there():
    """A relative link that leads nowhere is a promise that was not kept."""
    text = README.read_text(encoding="utf-8")
    targets = [target for target in re.findall(r"\]\(([^)]+)\)", text) if "://" not in target]

    assert targets
    assert [target for target in targets if not (ROOT / target).exists()] == []


def test_every_folder_of_the_map_exists():
    """The map names what is there, and nothing that is only planned."""
    folders = re.findall(r"^\| `([a-z]+)/` \|", README.read_text(encoding="utf-8"), re.MULTILINE)

    assert len(folders) > 5
    assert all(Path(ROOT / folder).is_dir() for folder in folders)

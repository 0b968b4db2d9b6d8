"""Generated parts of files are those of the code."""

import re

import pytest

from controller.packet_table import TABLE
from tools.pages import BLOCKS, NO_CERTIFICATES, generated, packets
from tools.tree import ROOT


@pytest.mark.parametrize("name", [*BLOCKS, "docker-compose.yml"])
def test_a_generated_part_is_that_of_the_code(name: str) -> None:
    """`make docs` writes it; a change of the code without it fails here."""
    assert (ROOT / name).read_text(encoding="utf-8") == generated()[name]


def test_a_file_stands_for_each_certificate() -> None:
    """For each secret of docker-compose.yml, until `make pki`."""
    stand = {name: text for name, text in generated().items() if name.startswith(NO_CERTIFICATES)}
    found = {path.relative_to(ROOT).as_posix() for path in (ROOT / NO_CERTIFICATES).iterdir()}
    assert found == stand.keys()
    assert all((ROOT / name).read_text(encoding="utf-8") == text for name, text in stand.items())


def test_each_packet_names_six_numbers() -> None:
    """Every command and report has its line; banks of one command have one each."""
    lines = packets().splitlines()[2:]
    assert {int(re.findall(r"\d+", line)[0]) for line in lines} == set(map(int, TABLE))
    assert all(len(line.split("|")[4].split(",")) == 6 for line in lines)

"""The tables of the packet and of protocol plain are those of the code."""

import re

from controller.packet_table import TABLE
from tools.packet_page import PAGES, packet_table, written


def test_the_packet_page_is_generated_from_the_code() -> None:
    """`make readme` writes it; a change of the table without it fails here."""
    for page in PAGES:
        assert page.read_text(encoding="utf-8") == written(page)


def test_each_line_names_six_numbers() -> None:
    """Every command and report has its line; banks of one command have one each."""
    lines = packet_table().splitlines()[2:]
    assert {int(re.findall(r"\d+", line)[0]) for line in lines} == set(map(int, TABLE))
    assert all(len(line.split("|")[4].split(",")) == 6 for line in lines)

"""Figures measured on the virtual clock: a page shows the present output of its command."""

from itertools import product

import pytest

from bench import over_tcp, settling
from bench.tables import as_markdown
from tools.figures import BLOCK, ROOT

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]


def rows_of(page: str, name: str) -> list[str]:
    """Return the rows of the table in a block."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (found,) = (each for each in BLOCK.finditer(text) if each["name"] == name)
    return [line for line in found["text"].splitlines() if line.startswith("| ")]


@pytest.mark.parametrize("mode", settling.MODES)
def test_the_settling_table_is_what_make_bench_prints(mode) -> None:
    """Settling, tau and overshoot of one mode, in every place."""
    stated = [row for row in rows_of("docs/demo.md", "settling") if row.startswith(f"| {mode},")]
    places = product(settling.STIFFNESSES_N_M, settling.DELAYS_MS)
    found = {case: settling.run(case) for case in (settling.Case(mode, *place) for place in places)}
    _, _, *rows = as_markdown(settling.HEAD, settling.rows(found, (mode,))).splitlines()
    assert stated == rows


@pytest.mark.parametrize("number", range(0, len(over_tcp.cases()), 30))
def test_a_row_over_tcp_is_what_make_bench_tcp_prints(number: int) -> None:
    """One of thirty rows: all of them take a quarter of an hour."""
    cases = over_tcp.cases()
    stated = rows_of("docs/over-tcp.md", "over-tcp")[-len(cases) :]
    assert stated[number] == f"| {' | '.join(over_tcp.row(over_tcp.run(cases[number])))} |"

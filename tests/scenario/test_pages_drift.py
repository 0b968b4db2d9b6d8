"""Figures measured on the virtual clock: a page shows the present output of its command."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import product

import pytest

from bench import over_tcp, settling
from bench.force import tcp_releases
from bench.force.page import limited_table, slow_table, tcp_table
from bench.force.run import LIMITED, TABLES, Extent, Row
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


@pytest.mark.parametrize(
    ("name", "extent", "table"),
    [
        ("slow loops", Extent(), slow_table),
        ("over TCP", Extent(over_tcp=tcp_releases.CASES[::5]), tcp_table),
        ("limited speed", Extent(limited=LIMITED[::2]), limited_table),
    ],
)
def test_rows_of_the_force_page_are_what_make_bench_force_prints(
    name: str, extent: Extent, table: Callable[[list[Row]], str]
) -> None:
    """All or some of three tables; the whole page takes ten minutes."""
    with ThreadPoolExecutor(1) as pool:
        _, _, *rows = table(TABLES[name](extent, pool)).splitlines()
    assert rows
    assert set(rows) <= set(rows_of("docs/force.md", "force"))

"""From what a bench measures to the page: rounding, the stored file, the blocks of pages."""

import random
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench import __main__ as command
from bench.harness import QUICK_STEP, CaseTable, Options, unmet, worst
from bench.pages import BLOCK, as_markdown, differing, heading, rendered
from bench.results import RESULTS, ROOT, Result, as_json, read, stored, table, write

COLUMNS = {"law": "", "settling_s": ".3g", "overshoot_pct": ".1f", "met": ""}
ROWS = [
    {"law": "plain", "settling_s": 0.12345, "overshoot_pct": 4, "met": True},
    {"law": 'a "law" of | signs', "settling_s": inf, "met": False},
]
RESULT = Result("speed", "make speed", "abc123", "2026-11-27", "2 cores",
                {"all": table(COLUMNS, ROWS), "none": table({"x_N": "d"}, [])})  # fmt: skip


@pytest.mark.parametrize(
    ("value", "form", "kept"),
    [(1.25, ".1f", 1.2), (1e5, "g", 100000), (5.0, ".0f", 5), (1040.0, ".3g", 1040.0),
     (inf, ".1f", None), (nan, ".1f", None), (None, "d", None), ("text", ".1f", "text"),
     (True, "", True)],
)  # fmt: skip
def test_a_value_is_stored_as_it_is_printed(value, form, kept) -> None:
    """Without a value, or with an infinite one, there is nothing to print."""
    assert stored(value, form) == kept


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    """One line for each row, so that a change of one is a change of one line."""
    write(RESULT, tmp_path)
    assert read("speed", tmp_path) == RESULT
    assert '    ["plain", 0.123, 4.0, true],\n' in as_json(RESULT)


def test_a_table_of_a_page_has_units_in_its_headings() -> None:
    """A requirement that is not met is bold."""
    assert as_markdown(RESULT.tables["all"]).splitlines() == [
        "| law | settling [s] | overshoot [%] | met |",
        "| --- | ---: | ---: | --- |",
        "| plain | 0.123 | 4.0 | yes |",
        '| a "law" of / signs | - | - | **no** |',
    ]
    assert heading("processor_core_pct") == "processor [% of a core]"
    assert heading("mean_N") == "mean [N]"
    assert heading("stiffness_N_m") == "stiffness [N/m]"


def test_a_block_shows_the_table_with_the_stamp_of_its_result(tmp_path: Path) -> None:
    """A new block, and one that was written before; the text around it stays."""
    write(RESULT, tmp_path)
    text = rendered("a\n<!-- measured speed.all -->\n<!-- end of speed.all -->\nb\n", tmp_path)
    assert text.startswith(
        "a\n<!-- measured speed.all by `make speed` at abc123, 2026-11-27, check "
    )
    assert text.endswith("| **no** |\n<!-- end of speed.all -->\nb\n")
    assert rendered(text.replace("0.123", "0.124"), tmp_path) == text


def test_every_page_shows_what_the_results_are() -> None:
    """Else: `python -m bench --render`."""
    assert [str(page) for page, _ in differing()] == []


def test_a_changed_figure_of_a_page_or_of_a_result_is_found(tmp_path: Path) -> None:
    """Whichever digit of whichever block it is."""
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        copied = tmp_path / page.relative_to(ROOT)
        copied.parent.mkdir(exist_ok=True)
        shutil.copy(page, copied)
    shutil.copytree(RESULTS, tmp_path / "docs" / "results")
    draw = random.Random(0)
    places = [
        (page, block.start() + digit.start())
        for page in (tmp_path / "docs").glob("*.md")
        for block in BLOCK.finditer(page.read_text(encoding="utf-8"))
        for digit in re.finditer(r"(?<=\| )\d", block.group())
    ]
    assert [*differing(tmp_path)] == []
    for page, place in draw.sample(places, 30):
        text = page.read_text(encoding="utf-8")
        digit = str((int(text[place]) + draw.randrange(1, 9)) % 10)
        page.write_text(text[:place] + digit + text[place + 1 :], encoding="utf-8")
        assert [found for found, _ in differing(tmp_path)] == [page]
        page.write_text(text, encoding="utf-8")


def test_every_stored_result_is_whole() -> None:
    """It was written by the harness: its rows fit its columns and its formats."""
    for path in RESULTS.glob("*.json"):
        result = read(path.stem)
        assert as_json(result) == path.read_text(encoding="utf-8"), path
        for each in result.tables.values():
            assert table(each.columns, each.records).rows == each.rows, path


# --- runs -----------------------------------------------------------------------------------------


def double(case: int) -> dict[str, int]:
    """Return a row with a value that no column has."""
    return {"case": case, "double": 2 * case, "raw": 7}


CASES = CaseTable({"case": "d", "double": "d"}, range(30), double)


def test_a_quick_run_takes_some_of_the_cases() -> None:
    """Rows keep their other values for the tables that are made of them."""
    with ThreadPoolExecutor(1) as pool:
        rows = CASES.measured(Options(pool, quick=True))
        assert len(CASES.measured(Options(pool))) == 30
    assert [row["case"] for row in rows] == [*range(0, 30, QUICK_STEP)]
    assert rows[1]["raw"] == 7
    assert CASES.stored(rows).rows[1] == [12, 24]


def test_the_worst_of_rows_without_a_value_is_infinite() -> None:
    """Nor is there a worst of none."""
    assert worst([1.0, 2.0]) == 2.0
    assert worst([1.0, None]) == inf
    assert worst([]) == inf


@pytest.fixture
def ran(monkeypatch, tmp_path) -> Path:
    """Return the folder of the results and pictures of a bench with one row that is not met."""
    bench = SimpleNamespace(measure=lambda options: dict(RESULT.tables))
    pictures = SimpleNamespace(draw=lambda result: (tmp_path / f"{result.name}.png").touch())
    modules = {"bench.speed": bench, "bench.pictures": pictures}
    monkeypatch.setattr(command, "BENCHES", {"speed": "bench.speed"})
    monkeypatch.setattr(command, "import_module", modules.__getitem__)
    monkeypatch.setattr(command, "ProcessPoolExecutor", ThreadPoolExecutor)
    monkeypatch.setattr(command, "write", lambda result: write(result, tmp_path))
    monkeypatch.setattr(command, "differing", list)
    return tmp_path


def run(monkeypatch, *words: str) -> int:
    """Run the command."""
    monkeypatch.setattr("sys.argv", ["bench", *words])
    return command.main()


def test_a_requirement_that_is_not_met_ends_with_one(ran, monkeypatch, capsys) -> None:
    """Nothing is stored without --write."""
    assert run(monkeypatch, "speed", "--json") == 1
    assert '"plain", 0.123' in capsys.readouterr().out
    assert [*ran.iterdir()] == []
    assert [*unmet(RESULT.tables)] == ['all: a "law" of | signs, None, None, False']


def test_a_written_run_stores_the_result_and_draws_its_picture(ran, monkeypatch) -> None:
    """A quick one is not stored: it has a part of the rows."""
    run(monkeypatch, "speed", "--write")
    assert sorted(path.name for path in ran.iterdir()) == ["speed.json", "speed.png"]
    with pytest.raises(SystemExit):
        run(monkeypatch, "speed", "--write", "--quick")

"""From what a bench measures to the page: rounding, the stored file, the blocks of pages."""

from concurrent.futures import ThreadPoolExecutor
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench import __main__ as command
from bench.harness import QUICK_STEP, CaseTable, Options
from bench.pages import as_markdown, differing, heading, rendered
from bench.results import RESULTS, Result, Table, as_json, as_tables, read, stored, table, write

ROWS = [
    {"law": "plain", "settling_s": 0.12345, "overshoot_pct": 4, "met": True},
    {"law": 'a "law" of | signs', "settling_s": inf, "met": False},
]
COLUMNS = {"law": "", "settling_s": ".3g", "overshoot_pct": ".1f", "met": ""}
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


def test_a_run_has_the_columns_and_formats_of_the_stored_result(tmp_path: Path) -> None:
    """A value without a column is not stored, a column without a value is left out."""
    write(RESULT, tmp_path)
    again = as_tables("speed", {"all": [{"raw": 1, "law": "x", "settling_s": 2.0}]}, tmp_path)
    assert again["all"] == Table({"law": "", "settling_s": ".3g"}, [["x", 2.0]])
    assert as_tables("speed", {"none": [{"met": False}]}, tmp_path)["none"].rows == [[False]]
    new = as_tables("new", {"all": [{"n": 1, "x": 1.23456, "name": "a"}, {"met": True}]}, tmp_path)
    assert new["all"].rows == [[1, 1.23456, "a", None], [None, None, None, True]]


def test_every_stored_result_is_whole() -> None:
    """It was written by the harness: its rows fit its columns and its formats."""
    for path in RESULTS.glob("*.json"):
        result = read(path.stem)
        assert as_json(result) == path.read_text(encoding="utf-8"), path
        for each in result.tables.values():
            assert table(each.columns, each.records).rows == each.rows, path


def double(case: int) -> dict[str, int]:
    """Return a row."""
    return {"case": case, "double": 2 * case}


def test_a_quick_run_takes_some_of_the_cases() -> None:
    """Every twelfth."""
    cases = CaseTable(range(30), double)
    with ThreadPoolExecutor(1) as pool:
        rows = cases.measured(Options(pool, quick=True))
        assert len(cases.measured(Options(pool))) == 30
    assert rows == [{"case": case, "double": 2 * case} for case in range(0, 30, QUICK_STEP)]


@pytest.fixture
def ran(monkeypatch, tmp_path) -> Path:
    """Return the folder of the results and pictures of a bench with one row that is not met."""
    bench = SimpleNamespace(measure=lambda options: {"all": ROWS})
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
    assert run(monkeypatch, "speed") == 1
    printed = capsys.readouterr()
    assert "0.1234" in printed.out
    assert printed.err == 'all: a "law" of | signs, None, None, False\n'
    assert [*ran.iterdir()] == []


def test_a_written_run_stores_the_result_and_draws_its_picture(ran, monkeypatch) -> None:
    """A quick one is not stored: it has a part of the rows."""
    run(monkeypatch, "speed", "--write")
    assert sorted(path.name for path in ran.iterdir()) == ["speed.json", "speed.png"]
    with pytest.raises(SystemExit):
        run(monkeypatch, "speed", "--write", "--quick")

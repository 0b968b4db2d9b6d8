"""Command of the force benchmark: tables that run alone, and finished ones that are kept."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from bench.force import __main__ as command


@pytest.fixture
def ran(monkeypatch, tmp_path) -> list[str]:
    """Return the names of the tables that have run; each has one row, and its page is a line."""
    names: list[str] = []

    def rows(name: str):
        def run(*_: object, **__: object) -> list[dict[str, str]]:
            names.append(name)
            return [{"table": name}]

        return run

    pages = {
        name: replace(own, rows=rows(name), page=lambda rows, made_by: f"# {rows} {made_by}")
        for name, own in command.OWN_PAGES.items()
    }
    monkeypatch.setattr(command, "OWN_PAGES", pages)
    monkeypatch.setattr(command, "TABLES", {name: rows(name) for name in ("release", "scenes")})
    monkeypatch.setattr(command, "page", lambda rows, made_by: f"# {sorted(rows)} {made_by}")
    monkeypatch.setattr(command, "ProcessPoolExecutor", ThreadPoolExecutor)
    monkeypatch.setattr(command, "as_block_page", lambda _name, text, _command: text)
    monkeypatch.setattr(command, "_draw", lambda *_: None)
    monkeypatch.setattr(command, "DOCS", tmp_path)
    return names


def run(monkeypatch, *words: object) -> None:
    """Run the command."""
    monkeypatch.setattr("sys.argv", ["bench.force", "--workers", "1", *map(str, words)])
    command.main()


def test_a_table_with_its_own_page_runs_alone(ran, monkeypatch, tmp_path) -> None:
    """Nothing else runs, and no other page is written."""
    run(monkeypatch, "--axes", "--write")
    assert ran == ["axes"]
    assert [path.name for path in tmp_path.iterdir()] == ["force-axes.md"]
    assert "--axes --write" in (tmp_path / "force-axes.md").read_text(encoding="utf-8")


def test_finished_tables_are_kept_in_the_file_and_not_run_again(ran, monkeypatch, tmp_path) -> None:
    """Also those that ran alone: the whole run takes the rest."""
    finished = tmp_path / "rows.json"
    run(monkeypatch, "--paths", "--rows", finished)
    run(monkeypatch, "--rows", finished)
    assert ran == ["paths", "axes", "release", "scenes"]
    assert set(json.loads(finished.read_text(encoding="utf-8"))) == set(ran)


def test_json_is_one_document_of_all_tables(ran, monkeypatch, capsys) -> None:
    """Nothing else is on standard output."""
    run(monkeypatch, "--json")
    assert set(json.loads(capsys.readouterr().out)) == set(ran)


def test_a_quick_run_does_not_replace_the_pages_of_a_whole_one(ran, monkeypatch, tmp_path) -> None:
    """Its few rows are printed only."""
    run(monkeypatch, "--axes", "--quick", "--write")
    assert ran == ["axes"]
    assert list(tmp_path.iterdir()) == []

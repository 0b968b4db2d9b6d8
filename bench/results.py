"""Results of the benches: tables of numbers in docs/results/<name>.json, with their stamp.

The stored result states the columns of each table, which end with their units, and their formats.
Numbers are stored as they are printed: a row that is measured again can be compared with it.
"""

import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"

Cell = float | int | str | bool | None  # None: there is no value, or it is infinite
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under columns, each of which has a format; text has an empty one."""

    columns: Mapping[str, str]
    rows: Sequence[Sequence[Cell]]

    @property
    def records(self) -> list[dict[str, Any]]:
        """The rows by the names of the columns."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


@dataclass(frozen=True, slots=True)
class Result:
    """Tables of one run of a bench, and what the run was; unknown parts of that are empty."""

    name: str
    command: str
    commit: str
    date: str
    machine: str
    tables: Mapping[str, Table]


def as_tables(
    name: str, measured: Mapping[str, Iterable[Row]], folder: Path = RESULTS
) -> dict[str, Table]:
    """Return the rows of a run as tables, with the columns and formats of the stored result.

    A table that is not stored yet has every value, as it is: write formats into the file, and the
    next run keeps them.
    """
    known = read(name, folder).tables if (folder / f"{name}.json").exists() else {}
    tables = {}
    for key, each in measured.items():
        rows = list(each)
        names = dict.fromkeys(chain(*rows), "")
        columns = dict(known[key].columns if key in known else names)
        if "met" in names:  # a requirement is never left out
            columns.setdefault("met", "")
        tables[key] = table(columns, rows)
    return tables


def table(columns: Mapping[str, str], rows: Sequence[Row]) -> Table:
    """Return rows as a table; a row without a value has none there, a column without any is left.

    A row may have more values than there are columns.
    """
    names = set().union(*rows) if rows else set(columns)
    shown = {name: form for name, form in columns.items() if name in names}
    return Table(
        shown, [[stored(row.get(name), form) for name, form in shown.items()] for row in rows]
    )


def stored(value: Any, form: str) -> Cell:
    """Return a value as it is stored."""
    if value is None or isinstance(value, bool | str):
        return value
    if not isfinite(value):
        return None
    number: float | int = json.loads(format(value, form))
    return number


def measured_now(name: str, command: str, tables: Mapping[str, Table]) -> Result:
    """Return tables with the stamp of this commit, day and machine."""
    words = ["git", "-C", str(ROOT), "rev-parse", "--short=10", "HEAD"]
    commit = subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    machine = f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
    return Result(name, command, commit, f"{datetime.now(UTC):%Y-%m-%d}", machine, tables)


def read(name: str, folder: Path = RESULTS) -> Result:
    """Return a stored result."""
    tree = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    tables = {key: Table(**each) for key, each in tree.pop("tables").items()}
    return Result(name=name, tables=tables, **tree)


def write(result: Result, folder: Path = RESULTS) -> None:
    """Store a result."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{result.name}.json").write_text(as_json(result), encoding="utf-8")


def as_json(result: Result) -> str:
    """Return a result as JSON with one line for each row."""
    stamp = ("command", "commit", "date", "machine")
    head = "".join(f" {json.dumps(key)}: {json.dumps(getattr(result, key))},\n" for key in stamp)
    tables = []
    for name, each in result.tables.items():
        rows = ",\n".join(f"    {json.dumps(row, ensure_ascii=False)}" for row in each.rows)
        tables.append(
            f'  {json.dumps(name)}: {{\n   "columns": {json.dumps(each.columns)},\n'
            f'   "rows": [\n{rows}\n   ]\n  }}'
        )
    return f'{{\n{head} "tables": {{\n' + ",\n".join(tables) + "\n }\n}\n"

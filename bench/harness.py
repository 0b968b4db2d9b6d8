"""What every bench is: a function that measures tables, mostly one row for each of its cases."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from bench.results import Row, Table, table

QUICK_STEP = 12  # a quick run takes every twelfth case


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a run."""

    pool: Executor
    quick: bool = False
    minutes: float | None = None  # of a bench in real time; None: its usual duration
    file: Path | None = None  # recording of a real sensor, for `payload`


Measure = Callable[[Options], dict[str, Table]]


@dataclass(frozen=True, slots=True)
class CaseTable:
    """A table with one row for each case; a row may have more values than there are columns."""

    columns: Mapping[str, str]
    cases: Sequence[Any]
    row: Callable[[Any], Row]

    def measured(self, options: Options) -> list[Row]:
        """Return the rows of all cases, or of some."""
        cases = self.cases[::QUICK_STEP] if options.quick else self.cases
        return list(options.pool.map(self.row, cases))

    def stored(self, rows: Sequence[Row]) -> Table:
        """Return the rows as a table."""
        return table(self.columns, rows)


def unmet(tables: Mapping[str, Table]) -> Iterator[str]:
    """Yield each row whose requirement is not met: it is in a column of this name."""
    for name, each in tables.items():
        for row in each.records:
            if row.get("met") is False:
                yield f"{name}: {', '.join(str(cell) for cell in row.values())}"


def worst(values: Iterable[float | None]) -> float:
    """Return the largest value; infinite where one is missing, or there is none."""
    return max((inf if value is None else value for value in values), default=inf)

"""What every bench is: a function that measures tables, mostly one row for each of its cases."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

from bench.results import Row, Table

QUICK_STEP = 12  # a quick run takes every twelfth case


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a run."""

    pool: Executor
    quick: bool = False
    minutes: float | None = None  # of a bench in real time; None: its usual duration
    file: Path | None = None  # recording of a real sensor, for `payload`


Tables = Mapping[str, Iterable[Row]]  # the columns of each: as_tables
Measure = Callable[[Options], Tables]


@dataclass(frozen=True, slots=True)
class CaseTable:
    """A table with one row for each case."""

    cases: Sequence[Any]
    row: Callable[[Any], Row]

    def measured(self, options: Options) -> list[Row]:
        """Return the rows of all cases, or of some."""
        cases = self.cases[::QUICK_STEP] if options.quick else self.cases
        return list(options.pool.map(self.row, cases))


def unmet(tables: Mapping[str, Table]) -> Iterator[str]:
    """Yield each row whose requirement is not met: it is in a column of this name."""
    for name, each in tables.items():
        for row in each.records:
            if row.get("met") is False:
                yield f"{name}: {', '.join(str(cell) for cell in row.values())}"


def grid(**values: Iterable[Any]) -> list[Row]:
    """Return every combination of values as a case."""
    return [dict(zip(values, each, strict=True)) for each in product(*values.values())]


def grouped(rows: Iterable[Row], *names: str) -> Iterator[tuple[Row, list[Row]]]:
    """Yield the rows that agree in these values, with the values."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    for place, ours in groups.items():
        yield dict(zip(names, place, strict=True)), ours


def largest(rows: Sequence[Row], names: Iterable[str]) -> Row:
    """Return the largest of each of these values, as `worst`."""
    return {name: worst(row[name] for row in rows) for name in names}


def worst(values: Iterable[float | None]) -> float:
    """Return the largest value; infinite where one is missing, or there is none."""
    return max((inf if value is None else value for value in values), default=inf)

"""Process fault injection into a moving cell: `python -m tests.chaos`.

Exit code 1 if a bound is violated.
"""

import argparse
import sys
from datetime import UTC, datetime
from pathlib import Path

from tests.chaos.cases import CELLS, Case, CellName, matrix, named, one_of_each_kind
from tests.chaos.memory import limit_file
from tests.chaos.outcome import Journal, Report, violations
from tests.chaos.run import CaseRunner
from tests.chaos.table import PAGE, page, rows
from tools.figures import as_block_page

ROOT = Path(__file__).resolve().parents[2]
UNTRIED_SHARE = 0.1  # share of trials that may be lost to machine stalls; they are listed


def main() -> int:
    """Run the requested trials; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--each", type=int, default=2, metavar="N",
                        help="injections per service and kind (default %(default)s)")  # fmt: skip
    parser.add_argument("--short", action="store_true",
                        help="one trial of each kind on each cell")  # fmt: skip
    parser.add_argument("--only", metavar="ROLE/KIND/PHASE", help="run only this trial")
    parser.add_argument("--cell", choices=CELLS, help="run only on this cell; with --only: sim")
    parser.add_argument("--seed", type=int, default=0, help="seed of the injection times")
    parser.add_argument("--write", action="store_true", help=f"write the table to {PAGE}")
    parser.add_argument("--journal", type=Path, metavar="FILE",
                        help="journal of trials; resumes an interrupted run")  # fmt: skip
    given = parser.parse_args()
    try:
        cases = selected(given)
    except ValueError as error:
        parser.error(str(error))
    journal = Journal(given.journal)
    report = CaseRunner(journal).run(journal.left(cases))
    broken = conclude(report)
    if given.write:
        text = page(report, given.each, datetime.now(UTC))
        (ROOT / PAGE).write_text(
            as_block_page("chaos", text, "python -m tests.chaos --each 20 --write"),
            encoding="utf-8",
        )
    return 1 if broken else 0


def selected(given: argparse.Namespace) -> list[Case]:
    """Return the cases that a command line selects. Raises ValueError for an unknown name."""
    if given.only:
        role, kind, phase = named(given.only)
        cell: CellName = given.cell or ("tcp" if role == "sensor" else "sim")
        return [Case(cell, role, kind, phase, given.seed)]
    cases = one_of_each_kind(given.seed) if given.short else matrix(given.each, given.seed)
    if limit_file() is None:
        print("NOT TRIED: memory (it needs root and memory control groups)", flush=True)
        cases = [case for case in cases if case.kind != "memory"]
    return [case for case in cases if given.cell in (None, case.cell)]


def conclude(report: Report) -> bool:
    """Print the tables and every violated bound; return whether there is one."""
    broken = []
    for name, limits in report.limits.items():
        outcomes = [outcome for outcome in report.outcomes if outcome.case.cell == name]
        print(f"\n{name}: at rest within {limits.still_s * 1e3:.0f} ms\n")
        print("\n".join(rows(outcomes, limits)))
        broken += [(o.case, found) for o in outcomes if (found := violations(o, limits))]
    print(f"\n{len(report.outcomes)} trials in {report.took_s:.0f} s, "
          f"{len(report.spoilt)} did not count and were repeated")  # fmt: skip
    for case, found in broken:
        print(f"BROKEN {case.name}: {'; '.join(found)}\n    again: {case.again}")
    for again in report.untried:
        print(f"NOT TRIED: {again}")
    return bool(broken) or len(report.untried) > UNTRIED_SHARE * len(report.outcomes)


if __name__ == "__main__":
    sys.exit(main())

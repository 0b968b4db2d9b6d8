"""Benches: `make bench ARGS=over-tcp` measures and prints, `--write` stores the result.

A stored result is docs/results/NAME.json; its tables in README.md and docs/, and its pictures, are
written as well. `--render` writes the pages from the stored results without measuring, `--check`
names those that differ. Exit code 1: a requirement is not met, or a page differs.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from bench.harness import Measure, Options, unmet
from bench.pages import as_markdown, differing
from bench.results import ROOT, as_tables, measured_now, write

BENCHES = {  # name: module with its `measure`
    "chain": "bench.chain.compare",
    "demos": "bench.demos",
    "faults": "bench.faults",
    "force": "bench.force.tables",
    "force-axes": "bench.force.axes",
    "force-path": "bench.force.paths",
    "forecast": "bench.forecast.measure",
    "installations": "bench.installations",
    "over-tcp": "bench.over_tcp",
    "payload": "bench.payload",
    "recorder": "bench.recorder",
    "sensor-faults": "bench.sensor_faults",
    "sensor-soak": "bench.sensor_soak",
    "settling": "bench.settling",
    "stalls": "bench.stalls",
}


def main() -> int:
    """Measure one bench, or compare pages with results."""
    given = _arguments()
    if given.render or given.check:
        return _render(writes=given.render)
    if given.name is None:
        print("\n".join(BENCHES))
        return 0
    measure: Measure = import_module(BENCHES[given.name]).measure
    with ProcessPoolExecutor() as pool:
        measured = measure(Options(pool, given.quick, given.minutes, given.file))
        tables = as_tables(given.name, measured)
    shown = (f"## {name}\n\n{as_markdown(each)}\n" for name, each in tables.items())
    Console(width=160).print(Markdown("\n".join(shown)))
    if given.write:
        result = measured_now(given.name, f"make bench ARGS={given.name}", tables)
        write(result)
        import_module("bench.pictures").draw(result)  # matplotlib takes a second
        _render(writes=True)
    missed = list(unmet(tables))
    print(*missed, sep="\n", end="\n" if missed else "", file=sys.stderr)
    return 1 if missed else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("name", nargs="?", choices=BENCHES, help="the bench")
    parser.add_argument("--write", action="store_true", help="store the result, write its pages")
    parser.add_argument("--quick", action="store_true", help="a few cases; nothing is stored")
    parser.add_argument("--minutes", type=float, help="duration of recorder, sensor-soak, demos")
    parser.add_argument("--file", type=Path, help="payload: recording to leave poses out of")
    parser.add_argument("--render", action="store_true", help="write pages from stored results")
    parser.add_argument("--check", action="store_true", help="name the pages that differ")
    given = parser.parse_args()
    if given.quick and given.write:
        parser.error("--write is of every case, without --quick")
    return given


def _render(*, writes: bool) -> int:
    """Write or name the pages that differ from the results."""
    pages = list(differing())
    for page, text in pages:
        if writes:
            page.write_text(text, encoding="utf-8")
        print(f"{page.relative_to(ROOT)}: {'written' if writes else 'differs from its results'}")
    return 0 if writes else min(1, len(pages))


if __name__ == "__main__":
    sys.exit(main())

"""The force benchmark: `make bench-force`, `python -m bench.force --quick`, `--json`, `--write`."""

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from bench.force import settle
from bench.force.page import page
from bench.force.paths import path_rows
from bench.force.paths_page import paths_page
from bench.force.promises import Rows
from bench.force.rig import SceneSettings
from bench.force.run import QUICK, SHORT, TABLES, Extent
from tools.figures import as_block_page

DOCS = Path(__file__).resolve().parents[2] / "docs"
TUNED_FOR = SceneSettings(2e4, 10)
MOST_OVERSHOOT_PCT = 25.0


def fixed_taus(place: tuple[float, int]) -> float:
    """Return the settling in tau of a PI law, tuned for one stiffness and delay, at others.

    Not a number if it does not settle, or lifts off the plate.
    """
    gain = 0.45 / (TUNED_FOR.stiffness_N_m * settle.true_tau_s(TUNED_FOR))
    world = SceneSettings(*place)
    done = settle.plain(world, gain, longest_s=6.0)
    flies = done.overshoot_pct > MOST_OVERSHOOT_PCT
    return float("nan") if done.taus is None or flies else done.taus


def main() -> None:
    """Run the benchmark, print, and write the requested outputs."""
    parser = argparse.ArgumentParser(prog="python -m bench.force", description=__doc__)
    extents = parser.add_mutually_exclusive_group()
    extents.add_argument("--quick", action="store_true", help="a few scenes: about a minute")
    extents.add_argument(
        "--short", action="store_true", help="fewer combinations: a third of the time"
    )
    parser.add_argument("--paths", action="store_true", help="only the path with force")
    parser.add_argument("--json", action="store_true", help="plain numbers on standard output")
    parser.add_argument(
        "--write", action="store_true", help="docs/force.md, docs/force-path.md and their pictures"
    )
    parser.add_argument("--rows", type=Path, help="file of finished tables")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    extent, option = (QUICK, "--quick ") if options.quick else (Extent(), "")
    if options.short:
        extent, option = SHORT, "--short "
    command = f'make bench-force ARGS="{option}--write"'
    with ProcessPoolExecutor(options.workers) as pool:
        _paths(pool, options)
        if options.paths:
            return
        rows: Rows = {}
        if options.rows is not None and options.rows.exists():
            rows = json.loads(options.rows.read_text(encoding="utf-8"))
        for name, table in TABLES.items():
            if name not in rows:
                rows[name] = table(extent, pool)
                if options.rows is not None:
                    options.rows.write_text(json.dumps(rows), encoding="utf-8")
        if options.json:
            print(json.dumps(rows))
        else:
            Console(width=160).print(Markdown(page(rows, command)))
        if options.write:
            from bench.force import pictures  # noqa: PLC0415 - matplotlib takes a second

            text = as_block_page("force", page(rows, command), command)
            (DOCS / "force.md").write_text(text, encoding="utf-8")
            pictures.releases(DOCS / "pictures" / "force-releases.png")
            pictures.following(DOCS / "pictures" / "force-following.png")
            places = list(product(settle.STIFFNESSES_N_M, settle.DELAYS_MS))
            fixed = dict(zip(places, pool.map(fixed_taus, places), strict=True))
            pictures.map_of(rows["release"], fixed, DOCS / "pictures" / "force-map.png")


def _paths(pool: ProcessPoolExecutor, options: argparse.Namespace) -> None:
    """Run the path with force, print, and write its page."""
    rows, command = path_rows(pool, quick=options.quick), 'make bench-force ARGS="--paths --write"'
    if options.json:
        print(json.dumps(rows))
    else:
        Console(width=160).print(Markdown(paths_page(rows, command)))
    if options.write and not options.quick:
        text = as_block_page("force-path", paths_page(rows, command), command)
        (DOCS / "force-path.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

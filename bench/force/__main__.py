"""The force benchmark: `make bench-force`, `python -m bench.force --quick`, `--json`, `--write`."""

import argparse
import json
import os
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Protocol

from rich.console import Console
from rich.markdown import Markdown

from bench.force import settle
from bench.force.axis_page import axes_page
from bench.force.axis_scenes import axis_rows
from bench.force.page import page
from bench.force.paths import path_rows
from bench.force.paths_page import paths_page
from bench.force.promises import Rows
from bench.force.rig import SceneSettings
from bench.force.run import QUICK, SHORT, TABLES, Extent, Row
from tools.figures import as_block_page

DOCS = Path(__file__).resolve().parents[2] / "docs"


class RowsOf(Protocol):
    """Function that runs a table."""

    def __call__(self, pool: Executor, *, quick: bool) -> list[Row]:
        """Return its rows."""


@dataclass(frozen=True, slots=True)
class OwnPage:
    """A table that can run alone, and its page."""

    rows: RowsOf
    page: Callable[[list[Row], str], str]
    file: str


OWN_PAGES = {
    "paths": OwnPage(path_rows, paths_page, "force-path"),
    "axes": OwnPage(axis_rows, axes_page, "force-axes"),
}
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
    options = _options()
    extent, option = (QUICK, "--quick ") if options.quick else (Extent(), "")
    if options.short:
        extent, option = SHORT, "--short "
    alone = [name for name in OWN_PAGES if getattr(options, name)]
    with ProcessPoolExecutor(options.workers) as pool:
        rows: Rows = {}
        if options.rows is not None and options.rows.exists():
            rows = json.loads(options.rows.read_text(encoding="utf-8"))
        for name in alone or [*OWN_PAGES, *TABLES]:
            if name not in rows:
                own = OWN_PAGES.get(name)
                rows[name] = (
                    own.rows(pool, quick=options.quick) if own else TABLES[name](extent, pool)
                )
                if options.rows is not None:
                    options.rows.write_text(json.dumps(rows), encoding="utf-8")
        if options.json:
            print(json.dumps(rows))
        writes = options.write and not options.quick
        for name in alone or OWN_PAGES:
            command = f'make bench-force ARGS="--{name} --write"'
            _publish(OWN_PAGES[name].file, OWN_PAGES[name].page(rows[name], command), command,
                     prints=not options.json, writes=writes)  # fmt: skip
        if not alone:
            command = f'make bench-force ARGS="{option}--write"'
            _publish("force", page(rows, command), command,
                     prints=not options.json, writes=options.write)  # fmt: skip
            if options.write:
                _draw(rows, pool)


def _options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.force", description=__doc__)
    extents = parser.add_mutually_exclusive_group()
    extents.add_argument("--quick", action="store_true", help="a few scenes: about a minute")
    extents.add_argument(
        "--short", action="store_true", help="fewer combinations: a third of the time"
    )
    parser.add_argument("--paths", action="store_true", help="only the path with force")
    parser.add_argument("--axes", action="store_true", help="only the tasks per axis")
    parser.add_argument("--json", action="store_true", help="plain numbers on standard output")
    parser.add_argument(
        "--write", action="store_true", help="docs/force*.md of the tables, and their pictures"
    )
    parser.add_argument("--rows", type=Path, help="file of finished tables")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    return parser.parse_args()


def _publish(file: str, text: str, command: str, *, prints: bool, writes: bool) -> None:
    """Print a page, and write it to docs/."""
    if prints:
        Console(width=160).print(Markdown(text))
    if writes:
        (DOCS / f"{file}.md").write_text(as_block_page(file, text, command), encoding="utf-8")
    if writes and file == "force-path":
        from bench.force import pictures  # noqa: PLC0415 - matplotlib takes a second

        pictures.paths(DOCS / "pictures" / "force-path.png")


def _draw(rows: Rows, pool: Executor) -> None:
    """Draw the pictures of docs/force.md."""
    from bench.force import pictures  # noqa: PLC0415 - matplotlib takes a second

    pictures.releases(DOCS / "pictures" / "force-releases.png")
    pictures.following(DOCS / "pictures" / "force-following.png")
    places = list(product(settle.STIFFNESSES_N_M, settle.DELAYS_MS))
    fixed = dict(zip(places, pool.map(fixed_taus, places), strict=True))
    pictures.map_of(rows["release"], fixed, DOCS / "pictures" / "force-map.png")


if __name__ == "__main__":
    main()

"""Forecasts of drawn jobs: `make bench-forecast`; `--write` the page, `--map` the map again."""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

from bench.forecast.fit import law_map, stamped
from bench.forecast.measure import (
    JOBS,
    JOBS_SEED,
    LAWS,
    MAP_JOBS,
    MAP_SEED,
    compared,
    contained_share,
    forecast_jobs,
    map_jobs,
    measured,
)
from bench.forecast.page import page, shares
from tools.figures import ROOT, as_block_page
from tuning.force_map import FILE

LEAST_CONTAINED = 0.9
MAP_COMMAND = "make bench-forecast ARGS=--map"


def main() -> int:
    """Measure the map, or run the drawn jobs; exit code 1: too few were contained."""
    parser = argparse.ArgumentParser(prog="python -m bench.forecast", description=__doc__)
    parser.add_argument("--map", action="store_true", help="measure tuning/force_map.json again")
    parser.add_argument("--jobs", type=int, default=JOBS)
    parser.add_argument("--seed", type=int, default=JOBS_SEED)
    parser.add_argument("--write", action="store_true", help="docs/forecast.md")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.workers) as pool:
        if options.map:
            _write_map(pool)
            return 0
        draw = forecast_jobs(options.jobs, options.seed)
        rows = compared(draw, pool)
    command = "make bench-forecast ARGS=--write"
    print(page(rows, draw, command) if not options.write else shares(rows))
    if options.write:
        text = as_block_page("forecast", page(rows, draw, command), command)
        (ROOT / "docs" / "forecast.md").write_text(text, encoding="utf-8")
    return 0 if contained_share(rows) >= LEAST_CONTAINED else 1


def _write_map(pool: ProcessPoolExecutor, file: Path = FILE) -> None:
    laws = {law: law_map(list(measured(map_jobs(law, MAP_JOBS), pool))) for law in LAWS}
    words = ["git", "-C", str(ROOT), "rev-parse", "--short=10", "HEAD"]
    commit = subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    made = {
        "command": MAP_COMMAND,
        "commit": commit,
        "day": f"{datetime.now(UTC):%Y-%m-%d}",
        "seed": MAP_SEED,
    }
    file.write_text(json.dumps(stamped(laws, made), indent=1) + "\n", encoding="utf-8")
    for law, tree in laws.items():
        for name, fit in tree["fits"].items():
            print(f"{law}, {name}: width {fit['width']:.3f}, contained {fit['contained']:.1%}")


if __name__ == "__main__":
    sys.exit(main())

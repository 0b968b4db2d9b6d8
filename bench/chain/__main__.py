"""The cell's chain compared with bare ones: `make bench-chain`; --full, --json, --write, --check.

Cell and bare chains are measured in turn, several times, in one run; what is compared are ratios
of medians. `--full` also varies rates, busy loops at the same time, and SCHED_FIFO.
"""

import argparse
import json
import os
import sys
from itertools import product
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from bench.chain.compare import Case, Comparison, compare
from bench.chain.page import COMMAND, page
from bench.chain.steps import steps_table
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from tools.figures import as_block_page

DOCS = Path(__file__).resolve().parents[2] / "docs"
USUAL = Case()
VARIED = [
    Case(sensor_hz, control_hz, busy, realtime)
    for (sensor_hz, control_hz), busy, realtime in product(
        ((500, 250), (1000, 250), (1000, 500)), (0, 4), (True, False)
    )
]


def main() -> None:
    """Measure, print, and write the requested outputs."""
    parser = argparse.ArgumentParser(prog="python -m bench.chain", description=__doc__)
    parser.add_argument("--full", action="store_true", help="also other rates, busy loops, no FIFO")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0, help="of each measurement")
    parser.add_argument("--json", action="store_true", help="numbers on standard output")
    parser.add_argument("--write", action="store_true", help="docs/chain.md and its picture")
    parser.add_argument("--check", action="store_true", help="fail on a ratio above its limit")
    options = parser.parse_args()
    os.environ.pop(ENDPOINT_VARIABLE, None)
    found: list[Comparison] = []
    for case in [USUAL, *(VARIED[1:] if options.full else [])]:
        print(f"{case}", file=sys.stderr)
        rounds = options.rounds if case == USUAL else 1
        found.append(compare(case, rounds, options.seconds))
        if not found[0].cells:
            sys.exit(f"{USUAL}: the arm held in every round: {'; '.join(found[0].held)}")
    if options.json:
        print(json.dumps([each.numbers() for each in found], indent=1))
    else:
        Console(width=120).print(Markdown(page(found, steps_table())))
    if options.write:
        from bench.chain.picture import draw  # noqa: PLC0415 - matplotlib takes a second

        text = as_block_page("chain", page(found, steps_table()), COMMAND)
        (DOCS / "chain.md").write_text(text, encoding="utf-8")
        draw(found[0], DOCS / "pictures" / "chain.png")
    if options.check and (excess := found[0].excess()):
        sys.exit("\n".join(excess))


if __name__ == "__main__":
    main()

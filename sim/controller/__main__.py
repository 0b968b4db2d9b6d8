"""Command `python -m sim.controller FILE.as`: runs an AS file; `--check` checks it, or a folder."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from forcemesh.errors import ForcemeshError
from sim.as_language.lint import check_file, check_folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Check or run a file; return the exit code."""
    given = _parser().parse_args(arguments)
    if not (given.check or given.strict):
        # Imported here: only a run needs the arm and the bus.
        from sim.controller.run import run  # noqa: PLC0415

        return run(given)
    try:
        if given.file.is_dir():
            return check_folder(given.file, least_share=given.share / 100.0)
        return check_file(given.file, strict=given.strict)
    except ForcemeshError as error:
        sys.stderr.write(f"{error}\n")
        return 2


def _percent(text: str) -> float:
    if not 0.0 <= (value := float(text)) <= 100.0:
        raise argparse.ArgumentTypeError(f"{text}: must be within 0 .. 100")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m sim.controller")
    parser.add_argument("file", type=Path, help="the .as or .pg file; --check: or a folder")
    parser.add_argument("--check", action="store_true",
                        help="parse the file and list findings without running it")  # fmt: skip
    parser.add_argument("--strict", action="store_true",
                        help="check: findings are errors (exit code 1)")  # fmt: skip
    parser.add_argument("--share", type=_percent, default=98.0, metavar="PERCENT",
                        help="of a folder: least that parse (default %(default)s)")  # fmt: skip
    parser.add_argument("--program", metavar="NAME", help="program to EXECUTE (default: main,"
                        " else the one named as the file, else the first)")  # fmt: skip
    parser.add_argument("--port", type=int, metavar="N",
                        help="listen on this port instead of the program's")  # fmt: skip
    parser.add_argument("--address", default="127.0.0.1", help="listen on this address only")
    parser.add_argument("--cell", metavar="FILE",
                        help="drive this cell's simulated arm, publish its sensor")  # fmt: skip
    parser.add_argument("--step-ms", type=float, metavar="X",
                        help="processor time per AS step (default: cell's, or 0.5)")  # fmt: skip
    parser.add_argument(
        "--speed",
        type=float,
        default=100.0,
        metavar="PERCENT",
        help="monitor speed (default %(default)s; a real controller starts at 10)",
    )
    answers = parser.add_mutually_exclusive_group()
    answers.add_argument("--like", type=Path, metavar="FILE",
                         help="behave as the controller of this probe.yaml")  # fmt: skip
    answers.add_argument("--pessimistic", action="store_true",
                         help="take the worse answer to every open question")  # fmt: skip
    return parser


if __name__ == "__main__":
    sys.exit(main())

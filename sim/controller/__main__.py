"""Command `python -m sim.controller FILE.as`: runs an AS file; `--check` only checks it."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from forcemesh.errors import ForcemeshError
from sim.as_language.lint import check_file


def main(arguments: Sequence[str] | None = None) -> int:
    """Check or run a file; return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if "--check" in words or "--strict" in words:
        return _check(words)
    return _run(words)


def _check(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m sim.controller")
    parser.add_argument("--check", action="store_true", help="parse and lint only")
    parser.add_argument("--strict", action="store_true", help="findings are errors (exit code 1)")
    parser.add_argument("file", type=Path, help="the .as or .pg file")
    given = parser.parse_args(words)
    try:
        return check_file(given.file, strict=given.strict)
    except ForcemeshError as error:
        sys.stderr.write(f"{error}\n")
        return 2


def _run(words: list[str]) -> int:
    # Imported here: only a run needs the arm and the bus.
    from sim.controller import run  # noqa: PLC0415

    parser = argparse.ArgumentParser(
        prog="python -m sim.controller",
        epilog="--check FILE [--strict] parses the file and lists findings without running it",
    )
    parser.add_argument("file", help="the .as or .pg file")
    run.add_arguments(parser)
    return run.run(parser.parse_args(words))


if __name__ == "__main__":
    sys.exit(main())

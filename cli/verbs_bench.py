"""Verbs `bench ...`: benchmarks of the project, which need its checkout."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from cli.context import USAGE, exit_with_error

bench = typer.Typer(no_args_is_help=True, help="Benchmarks of the project; need its checkout.")

ROOT = Path(__file__).resolve().parent.parent
PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True}


@bench.command("force", context_settings=PASSED_ON)
def force(
    context: typer.Context,
    *,
    quick: Annotated[bool, typer.Option("--quick", help="A few cases: about a minute.")] = False,
    short: Annotated[
        bool, typer.Option("--short", help="Fewer cases: a third of the time.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    write: Annotated[bool, typer.Option("--write", help="Write docs/force.md.")] = False,
) -> None:
    """Benchmark how the laws release, hold, approach and track a force, against other laws.

    Simulates its own cell in virtual time. Other options are passed to `python -m bench.force`.
    """
    flags = {"--quick": quick, "--short": short, "--json": as_json, "--write": write}
    chosen = [name for name, is_chosen in flags.items() if is_chosen]
    raise typer.Exit(_run("bench.force", [*chosen, *context.args]))


def _run(module: str, arguments: list[str]) -> int:
    """Run one of the project's benchmarks; return its exit code."""
    if not (ROOT / module.replace(".", "/")).is_dir():
        text = f"{module} not found: the benchmarks need a checkout of the project"
        exit_with_error(f"{text}, `git clone` it and `make setup`", USAGE)
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-m", module, *arguments]
    try:
        return subprocess.run(command, env=environment, check=False).returncode
    except KeyboardInterrupt:
        return 130

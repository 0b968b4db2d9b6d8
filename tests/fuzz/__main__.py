"""Fuzz one target or all: `python -m tests.fuzz --seconds 60 receiver`.

Needs atheris (x86-64 Linux).

Inputs that reach new branches are written to `out/fuzz/TARGET`, an input that violates a property
to `out/fuzz/TARGET-crash-...`: add it as a seed and as a test.
"""

import argparse
import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.fuzz.targets import AS_CORPUS, TARGETS

OUT = Path("out") / "fuzz"


def main() -> int:
    """Fuzz each requested target in its own process; return 1 if one failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--seconds", type=int, default=60, help="seconds per target")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    names = arguments.targets or list(TARGETS)
    if unknown := set(names) - set(TARGETS):
        parser.error(f"no such target: {', '.join(sorted(unknown))}")
    if arguments.here:
        return _fuzz(names[0], arguments.seconds)
    return max(_start(name, arguments.seconds) for name in names)


def _start(name: str, seconds: int) -> int:
    command = [sys.executable, "-m", "tests.fuzz", "--here", "--seconds", str(seconds), name]
    print(f"--- {name}", flush=True)
    return int(subprocess.run(command, check=False).returncode != 0)


def _fuzz(name: str, seconds: int) -> int:
    try:
        atheris = importlib.import_module("atheris")
    except ModuleNotFoundError:
        print("fuzzing needs atheris, available for Python 3.11 to 3.14 on x86-64 Linux")
        return 1
    with atheris.instrument_imports(include=list(TARGETS[name])):
        target: Any = importlib.import_module(f"tests.fuzz.{name}")
    seeds = importlib.import_module("tests.fuzz.seeds").seeds(name)
    corpus = OUT / name
    corpus.mkdir(parents=True, exist_ok=True)
    for seed, data in seeds.items():
        (corpus / seed).write_bytes(data)
    options: dict[str, Any] = {}
    if hasattr(target, "mutate"):
        options["custom_mutator"] = lambda data, size, seed: target.mutate(
            data, size, seed, atheris.Mutate
        )
    limits = [f"-max_total_time={seconds}", f"-max_len={target.MAX_BYTES}", "-rss_limit_mb=3000"]
    where = [f"-artifact_prefix={OUT / name}-", str(corpus)]
    where += [str(AS_CORPUS)] if name == "as_text" else []
    dictionary = Path(__file__).with_name(f"{name}.dict")
    words = [f"-dict={dictionary}"] if dictionary.exists() else []
    atheris.Setup(
        [name, *limits, "-timeout=20", "-print_final_stats=1", *words, *where],
        target.check,
        **options,
    )
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())

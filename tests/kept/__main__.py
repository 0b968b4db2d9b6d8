"""Store the outputs of runs anew: `python -m tests.kept [RUN ...]`. Only ever for a good reason.

What a run said is the law for every later change that is to change nothing. A change that is meant
to change something says in its commit which runs it has stored anew, and why.
"""

import sys

from tests.kept.outputs import kept_of, write
from tests.kept.runs import RUNS


def main(names: list[str]) -> int:
    """Play and store the named runs, or all."""
    if unknown := set(names) - RUNS.keys():
        sys.stderr.write(f"no such run: {', '.join(sorted(unknown))}; {', '.join(RUNS)} are\n")
        return 2
    for name in names or RUNS:
        kept = kept_of(RUNS[name].played())
        write(name, kept)
        sys.stdout.write(f"{name}: {len(kept.events)} events, {len(kept.numbers)} streams\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Store the outputs of runs again: `python -m tests.kept [RUN ...]`.

Only with a reason. The stored outputs are the reference of every later change without effect on
behaviour. A change with an intended effect states in its commit which runs it has stored again, and
why.
"""

import sys

from tests.kept.outputs import kept_of, write
from tests.kept.runs import RUNS


def main(names: list[str]) -> int:
    """Run and store the named runs, or all."""
    if unknown := set(names) - RUNS.keys():
        sys.stderr.write(f"no such run: {', '.join(sorted(unknown))}; {', '.join(RUNS)} are\n")
        return 2
    for name in names or RUNS:
        kept = kept_of(RUNS[name].run_cell())
        write(name, kept)
        sys.stdout.write(f"{name}: {len(kept.events)} events, {len(kept.numbers)} streams\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

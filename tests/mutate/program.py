"""Single changes of a step of the controller's program that a test must detect.

Comparisons, calculations, calls, assignments, numbers, and the way of braking and moving; not the
settings and the set-up. `tests.mutate --program` judges them.
"""

import random
import re
from collections.abc import Iterator
from contextlib import suppress

from sim.as_language.errors import AsSyntaxError
from sim.as_language.parser import parse
from tests.mutate.mutations import PROGRAM, Mutant

NOTHING = ".zz=0"  # a step that does nothing
SWAPS = (
    (r"<>", "=="), (r"==", "<>"), (r"(?<!<)>(?!=)", "<="), (r"<(?![>=])", ">="),
    (r"\bAND\b", "OR"), (r"\bOR\b", "AND"), (r"(?<=[\w\])])\+(?=[\w.$])", "-"),
    (r"(?<=[\w\])])-(?=[\w.])", "+"), (r"(?<=[\w\])])\*(?=[\w.(])", "/"), (r"\[1\]", "[2]"),
    (r"\[2\]", "[3]"), (r"\[4\]", "[5]"), (r"\[6\]", "[4]"), (r"\bMINVAL\b", "MAXVAL"),
    (r"\bSIN\b", "COS"), (r"\bBREAK\b", NOTHING), (r"\bBRAKE\b", NOTHING),
    (r"^ *fm\.[\w.]+=.*$", NOTHING), (r"^ *CALL [\w.]+$", NOTHING), (r"\bJMOVE\b", "LMOVE"),
    (r"(?<![\w.])1(?![\w.])", "2"), (r"(?<![\w.])2(?![\w.])", "3"),
)  # fmt: skip


def every() -> Iterator[tuple[int, Mutant]]:
    """Yield the line and the mutant of each possible change, in the order of the file."""
    lines, part = PROGRAM.read_text("ascii").split("\n"), ""
    for number, line in enumerate(lines, 1):
        if line.startswith(".PROGRAM "):
            part = line.split()[1].removeprefix("fm.").split("(")[0]
        code = line.split(";", 1)[0].rstrip()
        if not code or code.startswith(".") or part in ("config", "init"):
            continue
        blank = re.sub(r'"[^"]*"', lambda found: '"' + "~" * (len(found[0]) - 2) + '"', code)
        for pattern, replacement in SWAPS:
            for found in re.finditer(pattern, blank):
                new = code[: found.start()] + replacement + code[found.end() :]
                name = f"{number:4d}: {code.strip()}  ->  {new.strip()}"
                text = "\n".join([*lines[: number - 1], new, *lines[number:]])
                yield number, Mutant(PROGRAM.name, name, text)


def chosen(count: int, seed: int) -> list[Mutant]:
    """Return so many mutants that the parser accepts, each of another line; 0: of each line."""
    shuffled, taken = list(every()), dict[int, Mutant]()
    random.Random(seed).shuffle(shuffled)
    for line, mutant in shuffled:
        if (not count or len(taken) < count) and line not in taken:
            with suppress(AsSyntaxError):
                parse(mutant.text)
                taken[line] = mutant
    return [taken[line] for line in sorted(taken)]

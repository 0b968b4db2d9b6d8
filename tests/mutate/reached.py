"""The map of a mutation test: which test executes which line, and for how long."""

import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import coverage

from tests.mutate.mutations import PROGRAM, Mutant, line_of, path_of
from tools.tree import PRODUCTION, ROOT

OPTIONS = ("-q", "-p", "no:cacheprovider", "-m", "not (realtime or processes or long)")


class Reached:
    """The tests that execute each line of each module, and how long each test takes [s]."""

    def __init__(self, folder: Path) -> None:
        """Store the folder of the map."""
        self._map, self._durations = folder / "map", folder / "durations.xml"

    def make(self, tests: Sequence[str], jobs: int) -> int:
        """Run tests once with coverage; return the exit code of pytest."""
        folder = self._map.parent
        folder.mkdir(parents=True, exist_ok=True)
        settings = folder / "coveragerc"
        folders = "\n".join(f"    {each}/*" for each in PRODUCTION)
        text = f"[run]\nbranch = false\ndata_file = {self._map}\ninclude =\n{folders}\n"
        settings.write_text(text)
        command = [
            *(sys.executable, "-m", "pytest", *OPTIONS, "-n", str(jobs), "-o", "timeout=900"),
            *("--hypothesis-profile", "mutants", "--cov", f"--cov-config={settings}"),
            *("--cov-context=test", "--cov-report=", f"--junitxml={self._durations}", *tests),
        ]
        return subprocess.run(command, cwd=ROOT, check=False).returncode

    def read(self) -> None:
        """Read what was made."""
        self._data = coverage.CoverageData(str(self._map))
        self._data.read()
        self.took_s = {}
        for case in ET.parse(self._durations).iter("testcase"):  # noqa: S314 - written by ourselves
            path = case.attrib["classname"].replace(".", "/")
            self.took_s[f"{path}.py::{case.attrib['name']}"] = float(case.attrib["time"])

    @cache  # noqa: B019 - one object, for the whole run
    def lines(self, module: str) -> dict[int, set[str]]:
        """Return the tests of each line."""
        found = self._data.contexts_by_lineno(str(path_of(module)))
        return {
            line: {context.rsplit("|", 1)[0] for context in contexts if context}
            for line, contexts in found.items()
        }

    def by(self, mutant: Mutant) -> set[str]:
        """Return the tests that execute a mutant's line, or any of its module if no test does."""
        if mutant.module == PROGRAM.name:
            every = set().union(*self.lines("sim.controller.machine").values())
            return {each for each in every if each.startswith("tests/unit/controller/")}
        lines = self.lines(mutant.module)
        return lines.get(line_of(mutant)) or set().union(*lines.values())

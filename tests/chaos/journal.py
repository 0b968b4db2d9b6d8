"""Journal of trial outcomes, which makes a long run resumable."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from tests.chaos.cases import Case
from tests.chaos.outcome import Outcome


class Journal:
    """Journal file: one line of JSON for each trial, valid or not."""

    def __init__(self, path: Path | None) -> None:
        """Read an existing file; without a path nothing is stored."""
        self._path = path
        self.outcomes: list[Outcome] = []
        self.spoilt: list[str] = []
        if path is not None and path.exists():
            self._read(path.read_text(encoding="utf-8").splitlines())

    def left(self, cases: Iterable[Case]) -> list[Case]:
        """Return the cases without an outcome."""
        tried = {outcome.case for outcome in self.outcomes}
        return [case for case in cases if case not in tried]

    def tried(self, outcome: Outcome) -> None:
        """Record a valid trial."""
        self._write(asdict(outcome))

    def repeated(self, why: str) -> None:
        """Record an invalid trial."""
        self._write({"spoilt": why})

    def _read(self, lines: Iterable[str]) -> None:
        for line in lines:
            fields = json.loads(line)
            if "spoilt" in fields:
                self.spoilt.append(fields["spoilt"])
            else:
                self.outcomes.append(Outcome(**fields | {"case": Case(**fields["case"])}))

    def _write(self, fields: dict[str, object]) -> None:
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(fields) + "\n")

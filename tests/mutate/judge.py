"""All mutants: which tests run on each, in which processes, and the journal of the verdicts."""

import gc
import json
import os
import select
import signal
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import pytest

from tests.mutate.mutations import PROGRAM, Mutant, line_of
from tests.mutate.planting import (
    TIMES_LONGER,
    Functions,
    Kills,
    NewProcess,
    change_program,
    function_of,
    run_items,
    silence,
)
from tests.mutate.reached import Reached

HANGS = "a test that does not end"
MOST_S = 15.0  # of tests on one mutant
MOST_UNTIL_KILLED_S = 45.0  # of tests on a mutant that none of the first ones detects
MOST_OF_PROGRAM_S = 900.0  # the same for the controller's program: all tests of its own


@dataclass(frozen=True, slots=True)
class Verdict:
    """One line of the journal: tests without their parameters."""

    mutant: str
    line: int
    killed_by: Sequence[str]
    not_run: int  # tests that reach the line too, but the time was over


def places_of(mutant: Mutant) -> tuple[str, str]:
    """Return where a mutant is, from near to far: its function, its module."""
    return mutant.title.partition(": ")[0], mutant.module


def verdicts(journal: Path) -> list[Verdict]:
    """Return the verdicts of a journal."""
    lines = journal.read_text(encoding="utf-8").splitlines() if journal.is_file() else []
    return [Verdict(**json.loads(line)) for line in lines]


@dataclass(slots=True)
class Job:
    """A mutant in work: its tests, those left, the process, and what that has reported."""

    mutant: Mutant
    tests: list[str]
    left: list[str]
    stage: int = 0  # 0: in a fork, 1: in a new process, 2: the longer tests there
    pid: int = 0
    ends_s: float = 0.0
    text: bytes = b""


class Judge:
    """Plugin that, in place of running the tests once, runs them on each mutant."""

    def __init__(
        self, work: Sequence[Mutant], reached: Reached, journal: Path, jobs: int, *, every: bool
    ) -> None:
        self._journal, self._jobs, self._every = journal, jobs, every
        done = {verdict.mutant for verdict in verdicts(journal)}
        self._work = [mutant for mutant in work if mutant.title not in done]
        self._reached, self._took_s = reached, reached.took_s
        self._running: dict[int, Job] = {}  # by the end of the pipe that is read
        # Tests that detected mutants of this function, and of this module; the latest first.
        self._killers: dict[str, list[str]] = {}

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Judge all mutants."""
        self._session = session
        self._items = {item.nodeid: item for item in session.items}
        self._place = {item.nodeid: place for place, item in enumerate(session.items)}
        self._functions = Functions({mutant.module for mutant in self._work} - {PROGRAM.name})
        gc.collect()
        gc.freeze()
        for number, mutant in enumerate(self._work, 1):
            while len(self._running) >= self._jobs:
                self._wait()
            tests, left = self._split(self._reached.by(mutant), MOST_S)
            self._fork(Job(mutant, self._likely_first(mutant, tests), left))
            print(f"{number} of {len(self._work)}: {mutant.title}", file=sys.__stderr__, flush=True)
        while self._running:
            self._wait()
        return True

    def _split(self, ids: Iterable[str], most_s: float) -> tuple[list[str], list[str]]:
        """Return the shortest tests, in the order of their files, and the others."""
        known = [each for each in ids if each in self._items]
        known.sort(key=lambda each: (self._took_s.get(each, 1.0), each))
        total_s, count = 0.0, 0
        while (
            count < len(known)
            and (total_s := total_s + self._took_s.get(known[count], 1.0)) < most_s
        ):
            count += 1
        count = max(count, min(1, len(known)))
        return sorted(known[:count], key=self._place.__getitem__), known[count:]

    def _likely_first(self, mutant: Mutant, tests: list[str]) -> list[str]:
        """Return tests with those first that detected other mutants nearby."""
        nearby = [each for place in places_of(mutant) for each in self._killers.get(place, ())]
        rank = {each: place for place, each in enumerate(dict.fromkeys(nearby))}
        return sorted(tests, key=lambda each: rank.get(function_of(each), len(nearby)))

    def _fork(self, job: Job) -> None:
        read, write = os.pipe()
        job.pid = os.fork()
        if job.pid == 0:
            os.setpgid(0, 0)
            os.close(read)
            try:
                silence()
                self._child(job, write)
            finally:
                os._exit(0)
        os.close(write)
        expected_s = sum(self._took_s.get(each, 1.0) for each in job.tests)
        job.ends_s = time.monotonic() + 60.0 + TIMES_LONGER * expected_s
        self._running[read] = job

    def _child(self, job: Job, write: int) -> None:
        mutant = job.mutant
        if mutant.module == PROGRAM.name:
            change_program(mutant.text)
        elif job.stage or not self._functions.change(mutant):
            took_s = {each: self._took_s.get(each, 1.0) for each in job.tests}
            NewProcess(mutant.module, mutant.text, took_s, self._every).run(write)
            return
        kills = Kills(write, self._took_s)
        items = [self._items[each] for each in job.tests]
        kills.pytest_collection_modifyitems(items)
        self._session.config.pluginmanager.register(kills)
        run_items(self._session, items, kills, every=self._every)

    def _wait(self) -> None:
        """Take what the processes report; end those that take too long."""
        for read in select.select(list(self._running), [], [], 1.0)[0]:
            if piece := os.read(read, 65536):
                self._running[read].text += piece
            else:
                self._end(read)
        for read, job in list(self._running.items()):
            if time.monotonic() > job.ends_s:
                os.killpg(job.pid, signal.SIGKILL)
                job.text += f"{HANGS}\n".encode()
                self._end(read)

    def _end(self, read: int) -> None:
        job = self._running.pop(read)
        os.close(read)
        os.waitpid(job.pid, 0)
        killers = sorted(set(job.text.decode().split("\n")) - {""})
        for place in places_of(job.mutant) if killers else ():
            before = [each for each in self._killers.get(place, ()) if each not in killers]
            self._killers[place] = [*killers, *before]
        in_python = job.mutant.module != PROGRAM.name
        if not killers and job.stage == 0 and in_python:
            # a table that is made at the import may hold the change
            self._fork(replace(job, stage=1, text=b""))
        elif not killers and job.left and job.stage < 2:
            most_s = MOST_UNTIL_KILLED_S if in_python else MOST_OF_PROGRAM_S
            tests, left = self._split(job.left, most_s)
            self._fork(Job(job.mutant, tests, left, stage=2))
        else:
            verdict = Verdict(job.mutant.title, line_of(job.mutant), killers, len(job.left))
            with self._journal.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(verdict)) + "\n")

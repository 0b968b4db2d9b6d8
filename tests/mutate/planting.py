"""One mutant: its change in the running process or in a new one, and the tests that fail there."""

import gc
import importlib.abc
import importlib.util
import inspect
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import pytest

from tests.mutate.mutations import PROGRAM, Mutant, path_of
from tests.mutate.reached import OPTIONS
from tools.tree import ROOT

MUTANTS = ("-p", "no:xdist", "--hypothesis-profile", "mutants")
NOT_IMPORTED = "what all tests need cannot be imported"
RAN = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED)
SURPLUS_S, TIMES_LONGER = 10.0, 6.0  # a test that takes longer than both together hangs


def function_of(nodeid: str) -> str:
    """Return a test without its parameters."""
    return nodeid.split("[", 1)[0]


class Kills:
    """Plugin that reports each test that fails, and runs no test whose function failed already."""

    def __init__(self, write: int, longest_s: dict[str, float]) -> None:
        self._write, self._longest_s = write, longest_s
        self.functions: set[str] = set()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Bound the time of each test."""
        for item in items:
            longest_s = SURPLUS_S + TIMES_LONGER * self._longest_s.get(item.nodeid, 1.0)
            item.add_marker(pytest.mark.timeout(longest_s), append=False)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Report a failure."""
        if report.failed:
            self._kill(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Report a module that can't be imported."""
        if report.failed:
            self._kill(report.nodeid)

    def _kill(self, nodeid: str) -> None:
        function = function_of(nodeid)
        if function not in self.functions:
            self.functions.add(function)
            os.write(self._write, f"{function}\n".encode())


def silence() -> None:
    """Discard what tests print."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)


def codes_of(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of each function of a module and its classes."""
    for each in code.co_consts:
        if isinstance(each, CodeType):
            if each.co_flags & inspect.CO_NEWLOCALS:
                yield each
            else:
                yield from codes_of(each)


def differs(a: CodeType, b: CodeType) -> bool:
    """Return whether two functions do something else."""
    return (a.co_code, a.co_consts, a.co_names) != (b.co_code, b.co_consts, b.co_names)


class Functions:
    """Functions of the modules in this process, whose code can be replaced."""

    def __init__(self, modules: Iterable[str]) -> None:
        self._found: dict[tuple[str, str, int], list[FunctionType]] = defaultdict(list)
        files = {str(path_of(module)) for module in modules}
        gc.unfreeze()  # what is frozen is not among the objects
        for each in gc.get_objects():
            if isinstance(each, FunctionType) and each.__code__.co_filename in files:
                code = each.__code__
                key = (code.co_filename, code.co_qualname, code.co_firstlineno)
                self._found[key].append(each)

    def change(self, mutant: Mutant) -> bool:
        """Replace the code that a mutant changes; return False for one that only an import runs."""
        path = str(path_of(mutant.module))
        old = compile(path_of(mutant.module).read_text(), path, "exec", dont_inherit=True)
        new = compile(mutant.text, path, "exec", dont_inherit=True)
        # An inserted line moves what follows, so only the first difference is the mutant's.
        for was, becomes in zip(codes_of(old), codes_of(new), strict=True):
            if differs(was, becomes):
                key = path, was.co_qualname, was.co_firstlineno
                for function in self._found[key]:
                    function.__code__ = becomes
                return bool(self._found[key])
        return False


def change_program(text: str) -> None:
    """Put a changed program of the controller in the place of the shipped one, in this process."""
    shipped, read = PROGRAM.read_text("ascii"), Path.read_text
    gc.unfreeze()  # what is frozen is not among the objects
    for each in gc.get_objects():
        if isinstance(each, ModuleType):
            for name in [name for name, value in vars(each).items() if is_text(value, shipped)]:
                setattr(each, name, text)
        elif isinstance(each, FunctionType):
            defaults = each.__kwdefaults__ or {}
            defaults.update({name: text for name in defaults if is_text(defaults[name], shipped)})
    Path.read_text = lambda path, *words, **more: (  # type: ignore[method-assign]
        text if path.name == PROGRAM.name else read(path, *words, **more)
    )


def is_text(value: object, text: str) -> bool:
    """Return whether an object is this text; others may have a comparison of their own."""
    return isinstance(value, str) and value == text


def run_items(
    session: pytest.Session, items: Sequence[pytest.Item], kills: Kills, *, every: bool
) -> None:
    """Run tests until one fails, or each function until it fails with one set of parameters."""
    state = session._setupstate  # pytest has no public way to leave out a test
    for number, item in enumerate(items):
        if function_of(item.nodeid) in kills.functions:
            continue
        if kills.functions and not every:
            return
        following = items[number + 1] if number + 1 < len(items) else None
        state.teardown_exact(item)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)


class Instead(importlib.abc.MetaPathFinder):
    """Import finder that loads one module from another text."""

    def __init__(self, module: str, text: str) -> None:
        """Store the module and its text."""
        self._module, self._text = module, text

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the origin of the changed module, None for others."""
        if fullname != self._module:
            return None
        loader = ChangedText(fullname, str(path_of(fullname)), self._text)
        return importlib.util.spec_from_file_location(fullname, loader.path, loader=loader)


class ChangedText(SourceFileLoader):
    """Loader that compiles a text instead of the file."""

    def __init__(self, fullname: str, path: str, text: str) -> None:
        """Store the text."""
        super().__init__(fullname, path)
        self._text = text

    def get_code(self, _fullname: str) -> CodeType:
        """Return the code; no cache is read or written."""
        return compile(self._text, self.path, "exec", dont_inherit=True)


@dataclass(frozen=True, slots=True)
class NewProcess:
    """Tests on a changed text, in a process that has imported nothing of the product."""

    module: str
    text: str
    took_s: dict[str, float]  # the tests, each with its duration
    every: bool

    def run(self, write: int) -> None:
        """Run them there; they report to a pipe."""
        command = [sys.executable, "-m", "tests.mutate", "--in-new-process", str(write)]
        work = json.dumps(asdict(self))
        subprocess.run(command, cwd=ROOT, pass_fds=[write], input=work, text=True, check=False)

    def main(self, write: int) -> None:
        """Run them here."""
        sys.meta_path.insert(0, Instead(self.module, self.text))
        with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
            file.write("\n".join(self.took_s))
            file.flush()
            options = [*OPTIONS, *MUTANTS, *([] if self.every else ["-x"]), f"@{file.name}"]
            ended = pytest.main(options, plugins=[Kills(write, self.took_s)])
        if ended not in RAN:
            os.write(write, f"{NOT_IMPORTED}\n".encode())

"""One mutant: what is changed in a process that has imported everything, and who then notices."""

import os
from collections.abc import Callable
from functools import partial

import pytest

from common.motion import permission
from tests.mutate import mutations, planting
from tests.mutate.mutations import Mutant

MODULE = permission.__name__


def in_child(work: Callable[[], bool]) -> bool:
    """Return whether something is true in a forked process, whose changes end with it."""
    pid = os.fork()
    if pid == 0:
        try:
            os._exit(not work())
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def mutants_in(function: str) -> list[Mutant]:
    """Return the mutants of a function of the module."""
    return [each for each in mutations.mutants_of(MODULE) if each.name.startswith(f"{function}: ")]


def test_a_change_of_a_function_reaches_all_who_have_imported_it() -> None:
    """The same function object has other code; in this process it is as before."""
    functions, outranks = planting.Functions([MODULE]), permission.outranks
    before = [outranks(a, b) for a in permission.RANKS for b in permission.RANKS]

    def differs(mutant: Mutant) -> bool:
        assert functions.change(mutant)
        return [outranks(a, b) for a in permission.RANKS for b in permission.RANKS] != before

    mutants = mutants_in("outranks")
    assert mutants
    assert any(in_child(partial(differs, each)) for each in mutants)
    assert [outranks(a, b) for a in permission.RANKS for b in permission.RANKS] == before


def test_a_change_of_a_constant_needs_a_new_process() -> None:
    """Others have imported its value already."""
    functions = planting.Functions([MODULE])
    constant = mutants_in("module")[0]
    assert in_child(lambda: not functions.change(constant))


def test_the_line_of_a_mutant_is_that_of_its_change() -> None:
    """Counted in the unchanged text, also where lines are inserted."""
    lines = mutations.path_of(MODULE).read_text().splitlines()
    for mutant in mutations.mutants_of(MODULE):
        line = mutations.line_of(mutant)
        assert mutant.text.splitlines()[: line - 1] == lines[: line - 1]
        assert mutant.text.splitlines()[line - 1] != lines[line - 1]


def test_a_failing_test_is_reported_once_without_its_parameters() -> None:
    """Its other parameters are not run."""
    read, write = os.pipe()
    kills = planting.Kills(write, {})
    for nodeid in ("a.py::t[1]", "a.py::t[2]"):
        report = pytest.TestReport(nodeid, ("a.py", 1, ""), {}, "failed", None, "call")
        kills.pytest_runtest_logreport(report)
    os.close(write)
    with os.fdopen(read) as pipe:
        assert pipe.read() == "a.py::t\n"
    assert kills.functions == {"a.py::t"}


TEXT = mutations.PROGRAM.read_text("ascii")


def loaded(*, text: str = TEXT) -> str:
    """Return a program whose default was read before."""
    return text


def test_a_changed_program_is_what_tests_load() -> None:
    """Also where it was read before, and as the default of an argument."""
    text = TEXT.replace("fm.hseq=fm.hseq+1", "fm.hseq=fm.hseq+2")

    def is_loaded() -> bool:
        planting.change_program(text)
        return {TEXT, loaded(), mutations.PROGRAM.read_text("ascii")} == {text}

    assert text != TEXT
    assert in_child(is_loaded)


def test_a_module_that_cannot_be_imported_is_detected() -> None:
    """Although no test runs: what pytest imports first may need it."""
    read, write = os.pipe()
    test = "tests/unit/controller/test_packet.py"
    planting.NewProcess("controller.packet", "b'' - b''\n", {test: 1.0}, every=False).run(write)
    os.close(write)
    with os.fdopen(read) as pipe:
        assert pipe.read() != ""

"""The AS corpus: each file does what its comments specify, and together they leave nothing out."""

import re
from itertools import chain
from pathlib import Path
from typing import get_args

import pytest

from controller.error_codes import code_of
from sim.as_language import keywords, syntax
from sim.as_language.errors import TEXTS
from sim.as_language.formats import WRITERS
from sim.as_language.lint import check_text
from sim.as_language.lint_rules import nodes
from sim.as_language.operators import BINARY, UNARY
from sim.as_language.parser import KINDS
from sim.as_language.special_functions import ALL_NAMES
from tests.corpus.cases import FILES, directives, expected, numbers, run

SPACES = {"C", "S", "X"}  # formats that write no number
PARTS = {"X", "Y", "Z", "OAT", "O", "A", "T"}  # of POINT
EMULATOR = Path(__file__).resolve().parents[4] / "sim" / "controller"
TCP_RESULTS = {-34022, -34023, -34024, -34025, -34055, -34056, -34057}

each_file = pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)


@each_file
def test_a_program_ends_as_its_comments_specify(path: Path) -> None:
    """Mistakes, refusals, errors, printed lines and the globals at the end."""
    outcome = run(path)
    assert outcome.mistakes == directives(path, "mistake")
    assert outcome.refused == "".join(directives(path, "refused"))
    assert outcome.stops == directives(path, "stops")
    printed = directives(path, "prints")
    assert not printed or outcome.printed == printed
    for line in directives(path, "after"):
        name, value, within = expected(line)
        found = outcome.value(name)
        if numbers(value):
            assert numbers(found) == pytest.approx(numbers(value), abs=within, rel=0.0), line
        else:
            assert found == value, line


@each_file
def test_a_program_has_an_expectation(path: Path) -> None:
    """One at least."""
    words = ("after", "prints", "stops", "refused", "mistake")
    assert any(directives(path, word) for word in words)


# --- what is left out: nothing --------------------------------------------------------------------


def executed() -> list[syntax.ProgramStep]:
    """Every step that any program of the corpus has executed without an error."""
    return list(chain.from_iterable(run(path).executed for path in FILES))


def found(kind: type) -> list[object]:
    """Every node of a kind in the steps that were executed."""
    inside = chain.from_iterable(nodes(step.statement) for step in executed())
    return [node for node in inside if isinstance(node, kind)]


def test_every_instruction_is_executed() -> None:
    """By the emulator's own table."""
    names = {node.name for node in found(syntax.Instruction)}  # type: ignore[attr-defined]
    assert set(keywords.EMULATED) - names == set()


def test_every_other_statement_is_executed() -> None:
    """IF, POINT and the like, by the first word of their lines; PRINT and TYPE, too."""
    words = {word.upper() for step in executed() for word in re.findall(r"[A-Za-z]+", step.text)}
    assert set(keywords.STATEMENTS) - words == set()
    kinds = {type(step.statement) for step in executed()}
    every = set(get_args(syntax.Statement))
    assert every - kinds == set()
    parts = {node.part for node in found(syntax.PointStatement)}  # type: ignore[attr-defined]
    assert parts == PARTS | {""}


def test_every_function_is_computed() -> None:
    """Also those that search for a variable or change it."""
    names = {node.name for node in found(syntax.FunctionCall)}  # type: ignore[attr-defined]
    assert set(ALL_NAMES) - names == set()


def test_every_operator_is_computed() -> None:
    """Also the second spellings of relations."""
    binary = {node.operator for node in found(syntax.Binary)}  # type: ignore[attr-defined]
    unary = {node.operator for node in found(syntax.Unary)}  # type: ignore[attr-defined]
    assert set(BINARY) - binary == set()
    assert set(UNARY) - unary == set()
    text = " ".join(step.text for step in executed())
    assert all(spelling in text for spelling in ("=<", "=>", "!=", "<=", ">=", "<>"))


def test_every_format_and_data_section_is_used() -> None:
    """Formats that are an option of the controller excepted."""
    formats = {node.code for node in found(syntax.Format)}  # type: ignore[attr-defined]
    assert {*WRITERS, *SPACES} - formats == set()
    text = "".join(path.read_text("ascii") for path in FILES)
    assert {section for section in KINDS if f"\n{section}\n" not in text} == set()


def test_every_error_is_raised_and_every_text_is_read() -> None:
    """Each error of the emulator's source is raised here; other codes show their text."""
    source = "".join(
        path.read_text("utf-8") for path in EMULATOR.glob("*.py") if path.name != "errors.py"
    )
    raised = set(re.findall(r'"([PE]\d{4})"', source))
    words = ("stops", "refused", "mistake")
    documented = {
        text.split()[0] for path in FILES for word in words for text in directives(path, word)
    }
    of_behaviours = {"E1117", "E4025"}  # raised in tests/unit/controller/test_fmprobe_as.py
    assert raised - documented - of_behaviours == set()
    results = {expected(line)[1] for path in FILES for line in directives(path, "after")}
    assert TCP_RESULTS - results == set()
    read = set(re.findall(r'\$ERRORS\("(\w+)"\)', "".join(step.text for step in executed())))
    of_results = {code_of(number) for number in TCP_RESULTS}
    assert set(TEXTS) - documented - of_behaviours - read - of_results == set()


def test_the_corpus_holds_no_trap_that_the_check_knows_but_those_it_shows() -> None:
    """Programs that run to their end are good examples: the check has nothing against them."""
    good = [path for path in FILES if not (directives(path, "stops") or run(path).mistakes)]
    allowed = {"long-name", "same-name", "not-equal", "true-is-minus-1", "left-out", "percent"}
    for path in good:
        findings = check_text(path.read_text("ascii"), path.name).findings
        assert {finding.rule for finding in findings} <= allowed, findings

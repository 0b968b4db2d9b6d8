"""Flat steps: the targets of IF, WHILE, FOR, DO, CASE and GOTO, and open structures."""

from itertools import chain

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.as_language import syntax
from sim.as_language.errors import AsSyntaxError
from sim.as_language.parser import parse
from tests.fakes.as_language import program


def statements(*lines: str) -> list[syntax.Statement]:
    """The statements of a program of these lines."""
    return [step.statement for step in program(*lines).steps]


def test_if_goes_behind_its_else_and_else_to_its_end() -> None:
    """Without ELSE a false condition goes to END."""
    found = statements("IF 1 THEN", "x = 1", "ELSE", "x = 2", "END", "IF 0 THEN", "END")
    assert found[0] == syntax.If(syntax.Number(1.0), 3)
    assert found[2] == syntax.Else(4)
    assert found[4] == syntax.End("IF", 0)
    assert found[5] == syntax.If(syntax.Number(0.0), 6)


def test_loops_leave_behind_their_end_and_end_goes_back() -> None:
    """WHILE, FOR and DO, one in the other."""
    found = statements("WHILE x DO", "FOR i = 1 TO 3", "DO", "UNTIL x", "END", "END")
    assert [getattr(item, "false_at", None) for item in found[:2]] == [6, 5]
    assert found[3] == syntax.Until(syntax.Variable("", "x"), 2)
    assert found[4] == syntax.End("FOR", 1)
    assert found[5] == syntax.End("WHILE", 0)


def test_case_knows_its_branches_and_where_everything_else_goes() -> None:
    """VALUE and ANY that are run into go to END."""
    found = statements("CASE x OF", "VALUE 1,2:", "a = 1", "VALUE 3:", "ANY :", "a = 2", "END")
    case = found[0]
    assert isinstance(case, syntax.CaseStatement)
    assert [(len(branch.values), branch.body_at) for branch in case.branches] == [(2, 2), (1, 4)]
    assert case.default_at == 5
    assert [getattr(found[at], "end_at", None) for at in (1, 3, 4)] == [6, 6, 6]


def test_case_without_any_goes_to_its_end() -> None:
    """No branch runs."""
    case = statements("CASE x OF", "VALUE 1:", "END")[0]
    assert isinstance(case, syntax.CaseStatement)
    assert case.default_at == 2


def test_goto_finds_labels_before_and_behind_it() -> None:
    """Numbers and names, in and out of structures; one that is missing stays unresolved."""
    found = statements("10 x = 1", "GOTO out", "IF x GOTO 10", "GOTO nowhere", "out:")
    assert [getattr(item, "target", None) for item in found[1:4]] == [4, 0, -1]


def test_steps_are_counted_as_the_controller_lists_them() -> None:
    """Comments are steps, blank lines are not; text and line are kept for messages."""
    steps = program("; first", "", "  x = 1 ; why", "").steps
    assert [(step.number, step.where.line, step.text) for step in steps] == [
        (1, 2, "; first"), (2, 4, "x = 1 ; why"),
    ]  # fmt: skip
    assert steps[0].statement == syntax.Comment()


@pytest.mark.parametrize(
    ("lines", "code", "line"),
    [
        (["IF x THEN"], "P0140", 2),
        (["WHILE x DO", "IF x THEN", "END"], "P0140", 2),
        (["DO"], "P0144", 2),
        (["END"], "P0141", 2),
        (["DO", "END", "UNTIL x"], "P0141", 3),
        (["ELSE"], "P0142", 2),
        (["WHILE x DO", "ELSE", "END"], "P0142", 3),
        (["IF x THEN", "ELSE", "ELSE", "END"], "P0142", 4),
        (["UNTIL x"], "P0143", 2),
        (["VALUE 1:"], "P0145", 2),
        (["ANY :"], "P0145", 2),
        (["10 x = 1", "10 x = 2"], "P0146", 3),
    ],
)
def test_structures_that_do_not_close_are_named_with_their_line(
    lines: list[str], code: str, line: int
) -> None:
    """The message names the open structure."""
    with pytest.raises(AsSyntaxError) as caught:
        program(*lines)
    first = caught.value.mistakes[0]
    assert (first.code, first.where.line) == (code, line)


BLOCKS = st.recursive(
    st.just(["x = 1"]),
    lambda inner: st.one_of(
        st.lists(inner, min_size=1, max_size=3).map(lambda parts: [*chain(*parts)]),
        inner.map(lambda body: ["WHILE x DO", *body, "END"]),
        inner.map(lambda body: ["FOR i = 1 TO 2", *body, "END"]),
        inner.map(lambda body: ["DO", *body, "UNTIL x"]),
        st.tuples(inner, inner).map(lambda two: ["IF x THEN", *two[0], "ELSE", *two[1], "END"]),
        inner.map(lambda body: ["CASE x OF", "VALUE 1:", *body, "ANY :", *body, "END"]),
    ),
    max_leaves=8,
)


@given(BLOCKS)
def test_every_nesting_is_resolved(lines: list[str]) -> None:
    """No target is left open, all are in the program, every END knows its beginning."""
    found = statements(*lines)
    for at, item in enumerate(found):
        for name in ("false_at", "end_at", "default_at", "start_at"):
            target = getattr(item, name, None)
            assert target is None or 0 <= target <= len(found)
        if isinstance(item, syntax.End):
            assert item.start_at < at


def test_every_mistake_of_a_file_is_reported_at_once() -> None:
    """Not only the first one."""
    with pytest.raises(AsSyntaxError) as caught:
        parse(".PROGRAM a\nx = \ny = 1\nx = (\n.END\n.PROGRAM b\nEND\n.END", "two.as")
    assert [mistake.where.line for mistake in caught.value.mistakes] == [2, 4, 7]
    assert "two.as:4" in str(caught.value)

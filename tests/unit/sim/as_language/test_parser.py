"""The parser of AS: lines, structures, whole files, and the report of mistakes (facts 1.1, 1.2)."""

from pathlib import Path

import pytest

from sim.as_language import syntax
from sim.as_language.errors import AsError, AsSyntaxError
from sim.as_language.lines import parse_line
from sim.as_language.parser import load, parse
from sim.as_language.syntax import Binary, FunctionCall, Number, Text, Unary, Variable, Word
from tests.corpus.cases import FILES
from tests.unit.sim.as_language.conftest import expression, statement

ONE, TWO = Number(1.0), Number(2.0)
X, P = Variable("", "x"), Variable("", "p")


def in_other_case(line: str) -> tuple[str, str] | None:
    """Return a line in lower and in upper case, or None where case has a meaning."""
    return None if set(line) & set("\"';") else (line.lower(), line.upper())


def test_the_case_of_a_line_has_no_meaning() -> None:
    """For each line of the corpus that parses, texts and characters excepted."""
    lines = {line for path in FILES for line in path.read_text("ascii").splitlines()}
    compared = 0
    for lower, upper in filter(None, map(in_other_case, lines)):
        try:
            expected = parse_line(upper)
        except AsError:
            continue
        if "Text(" in repr(expected):  # kept unread
            continue
        assert parse_line(lower) == expected
        compared += 1
    assert compared > 500


@pytest.mark.parametrize(
    ("short", "full"),
    [("SI 1", "SIGNAL 1"), ("TW 1", "TWAIT 1"), ("CA p", "CALL p"), ("ACCU 1", "ACCURACY 1"),
     ("DECO x = p", "DECOMPOSE x = p"), ("PCEX 1: p", "PCEXECUTE 1: p"), ("TY 1", "TYPE 1"),
     ("MC EXEC p", "MC EXECUTE p"), ("RET", "RETURN"), ("LM p", "LMOVE p")],
)  # fmt: skip
def test_keywords_may_be_shortened(short: str, full: str) -> None:
    """As in appendix 5, and wherever no other word begins alike."""
    assert statement(short) == statement(full)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a/b2", Binary("/", Variable("", "a"), Variable("", "b2"))),
        ("a^b1", Binary("^", Variable("", "a"), Variable("", "b1"))),
        ("a/s[1]", Binary("/", Variable("", "a"), Variable("", "s", indices=(ONE,)))),
        ("1 BAND ^B10", Binary("BAND", ONE, TWO)),
        ("2^-1", Binary("^", TWO, Unary("-", ONE))),
        ("a =< b", Binary("<=", Variable("", "a"), Variable("", "b"))),
        ("a != b", Binary("<>", Variable("", "a"), Variable("", "b"))),
        ("a % b", Binary("MOD", Variable("", "a"), Variable("", "b"))),
        ("to + step", Binary("+", Variable("", "to"), Variable("", "step"))),
        ("a.b", Variable("", "a.b")),
        ("';", Number(59.0)),
        ('"a;b" ; comment', Text("a;b")),
        ("$CHR (2)", FunctionCall("$CHR", (TWO,))),
        ('VAL($DECODE(.$s," ",0))', FunctionCall("VAL", (FunctionCall("$DECODE", (
            Variable("$", "s", local=True), Text(" "), Number(0.0))),))),
        ("SWITCH(ERROR)", FunctionCall("SWITCH", (Word("error"),))),
        ("error == 0", Binary("==", FunctionCall("ERROR"), Number(0.0))),
    ],
)  # fmt: skip
def test_the_meaning_of_a_word_depends_on_its_place(text: str, expected: syntax.Expression) -> None:
    """Formats, binary numbers, functions and keywords are not distinguished by spelling alone."""
    assert expression(text) == expected


# --- structures -----------------------------------------------------------------------------------


# --- whole files ----------------------------------------------------------------------------------

BACKUP = """\
.*=== AS GROUP ===         : ASF_T2001000N 2020/05/26 17:51
.*
.SAVETIME 2021/03/29 07:49
.ROBOTDATA1
ZROBOT.TYPE    34  97   8 12051     -182851   X200L ( 2021-02-24 10:33 )
.END
.INTER_PANEL_D
0,1,"  OK","","","",10,7,4,10,2001,0
.END
.PROGRAM a.home() #9744
  JMOVE #[0,0,0,0,0,0]
.END
.PROGRAM b (.x, .$s,.#j,.a[]) @2021/03/29 #-12 ;text
.END
.PROGRAM c @1
.END
.program Comment___ () ; Comments for IDE. Do not use.
\t; @@@ PROJECT @@@
.END
.TRANS
p[3] 0.5 0 0 0 0 0
arm 1 2 3 4 5 6 7 8
.END
.JOINTS
#j 1 2 3 4 5 6
.END
.REALS
udp_port = 49152
.END
.STRINGS
$s = "a;b = c"
.END
.INTEGER
@n = -5
.END
"""


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_a_backup_is_read_whole(newline: str) -> None:
    """Programs with every kind of header, data, and sections that only a controller knows."""
    source = parse(BACKUP.replace("\n", newline))
    assert list(source.programs) == ["a.home", "b", "c", "comment___"]
    assert [v.spelling for v in source.programs["b"].parameters] == [".x", ".$s", ".#j", ".a"]
    assert source.programs["b"].parameters[3].whole
    assert [section.name for section in source.skipped] == [
        ".SAVETIME", ".ROBOTDATA1", ".INTER_PANEL_D",
    ]  # fmt: skip
    data = {item.variable: item.value for item in source.data}
    assert data[Variable("", "p", indices=(Number(3.0),))] == (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert data[Variable("", "arm")] == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
    assert data[Variable("$", "s")] == "a;b = c"
    assert data[Variable("@", "n")] == -5
    assert data[Variable("", "udp_port")] == 49152.0
    assert data[Variable("#", "j")] == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        (".PROGRAM p\nx = 1", "P0140", 1),
        (".PROGRAM p\n.PROGRAM q\n.END", "P0140", 1),
        (".PROGRAM p\nWHILE x DO\nIF x THEN\nEND\n.END", "P0140", 2),
        (".PROGRAM p\nWHILE x DO\nELSE\nEND\n.END", "P0142", 3),
        (".PROGRAM p\nIF x THEN\nELSE\nELSE\nEND\n.END", "P0142", 4),
        (".PROGRAM p(.x\n.END", "P0120", 1),
        (".PROGRAM p(.x+1)\n.END", "P0108", 1),
        (".PROGRAM p() nonsense\n.END", "P0108", 1),
        (".REALS\nx = 1 2\n.END", "P0100", 2),
        (".REALS\nx = 1E99\n.END", "P0100", 2),
        (".REALS\n$x = 1\n.END", "P0118", 2),
        (".TRANS\np 1 2 3\n.END", "P0100", 2),
        (".INTEGER\n@n =\n.END", "P0100", 2),
    ],
)
def test_a_mistake_of_a_file_is_reported_with_code_and_line(
    text: str, code: str, line: int
) -> None:
    """Never a Python exception, never silence."""
    with pytest.raises(AsSyntaxError) as caught:
        parse(text)
    first = caught.value.mistakes[0]
    assert (first.code, first.where.line) == (code, line)


def test_a_file_is_read_from_disk_byte_by_byte(tmp_path: Path) -> None:
    """One byte is one character, whatever the file's encoding was."""
    path = tmp_path / "x.as"
    path.write_bytes(b'.PROGRAM p\n$s = "\xff\xe4" ; \xd0\x9f\n.END')
    assert len(load(path).programs["p"].steps) == 1

"""Whole files: programs, data sections, skipped lines, refusals (facts 1.1)."""

from pathlib import Path

import pytest

from forcemesh.errors import DataError
from sim.as_language.errors import AsSyntaxError
from sim.as_language.parser import load, parse
from sim.as_language.syntax import Number, Variable

BACKUP = """\
.*=== AS GROUP ===         : ASF_T2001000N 2020/05/26 17:51
.*
.SAVETIME 2021/03/29 07:49
.NETCONF     192.0.2.11,"R1",255.255.255.0,0.0.0.0,""
.NETCONF2     192.0.2.12,255.255.255.0,0.0.0.0
.LANGUAGE ENGLISH
.ROBOTDATA1
ZROBOT.TYPE    34  97   8 12051     -182851   X200L ( 2021-02-24 10:33 )
SG_CAL[1]      1.6597000122e+02 -2.0e+02  268743957
.END
.INTER_PANEL_D
0,1,"  OK","","","",10,7,4,10,2001,0
.END
.AUXDATA
N_INT5    "motion_ok  "
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
tframe -158.983856 -716.104248 245 175.046768 179.998154 86.93544
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
$t[2] = ""
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
        ".SAVETIME", ".NETCONF", ".NETCONF2", ".LANGUAGE", ".ROBOTDATA1", ".INTER_PANEL_D",
        ".AUXDATA",
    ]  # fmt: skip
    data = {item.variable: item.value for item in source.data}
    assert data[Variable("", "p", indices=(Number(3.0),))] == (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert data[Variable("", "arm")] == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
    assert data[Variable("$", "s")] == "a;b = c"
    assert data[Variable("@", "n")] == -5
    assert data[Variable("", "udp_port")] == 49152.0
    assert data[Variable("#", "j")] == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def test_local_assignments_are_no_section_headers() -> None:
    """Inside a program a line may begin with a dot; .END in any case ends it."""
    source = parse(".PROGRAM p\n.x = 1\n.ending = 2\n.end\n")
    assert len(source.programs["p"].steps) == 2


def test_long_lines_are_read() -> None:
    """Real backups hold 207 columns, and more in comments."""
    line = "x = 1" + " + 1" * 60 + " ;" + "c" * 300
    assert len(parse(f".PROGRAM p\n{line}\n.END").programs["p"].steps) == 1


def test_the_last_of_two_programs_of_one_name_counts_and_is_remarked() -> None:
    """As a LOAD would replace it."""
    source = parse(".PROGRAM p\n.END\n.PROGRAM p\nx = 1\n.END")
    assert len(source.programs["p"].steps) == 1
    assert "twice" in source.remarks[0].text


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("x = 1", "P0109", 1),
        (".PROGRAM p\nx = 1", "P0140", 1),
        (".PROGRAM p\n.PROGRAM q\n.END", "P0140", 1),
        (".PROGRAM\n.END", "P0117", 1),
        (".PROGRAM 1x()\n.END", "P0117", 1),
        (".PROGRAM p(.x\n.END", "P0120", 1),
        (".PROGRAM p(.x+1)\n.END", "P0108", 1),
        (".PROGRAM p(1)\n.END", "P0108", 1),
        (".PROGRAM p() nonsense\n.END", "P0108", 1),
        (".REALS\nx = abc\n.END", "P0100", 2),
        (".REALS\nx = 1 2\n.END", "P0100", 2),
        (".REALS\nx = 1E99\n.END", "P0100", 2),
        (".REALS\n= 1\n.END", "P0108", 2),
        (".REALS\n$x = 1\n.END", "P0118", 2),
        (".STRINGS\n$x = 1\n.END", "P0108", 2),
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
    assert [(m.code, m.where.line) for m in caught.value.mistakes] == [(code, line)]


LINES = [
    ("x = (1", "P0120", 7, "end of the line; expected ')'"),
    ("a = 1)", "P0120", 6, "')'"),
    ('$s = "abc', "P0108", 6, "not closed"),
    ("x = a b", "P0121", 7, "'b'"),
    ("IF x y = 1", "P0121", 6, "expected THEN or GOTO"),
    ("IF a = b THEN", "P0108", 6, "To compare, write =="),
    ("FOR i = 1 3", "P0121", 11, "expected TO"),
    ("CASE x y", "P0121", 8, "expected OF"),
    ("cmd$ = 1", "P0108", 4, "'$'"),
    ("GOTO", "P0108", 5, "a label"),
    ("CALL 5", "P0108", 6, "the name of a program"),
    ("POINT p q", "P0121", 9, "expected '='"),
    ("POINT PI = 3", "P0117", 0, "the function PI"),
    ("HERE 5", "P0117", 0, "expected a variable"),
    ("x[1,2,3,4] = 1", "P0119", 0, "4 indices"),
    ("x = 1E99", "E0106", 0, "3.4E38"),
    ("x = \xe4", "P0108", 5, "must be ASCII"),
    ("x = 1 ? 2", "P0108", 7, "'?'"),
    ("x = $ENCODE(/F999.2,1)", "P0108", 0, "255 columns"),
    ("x = " + "-" * 200 + "1", "P0114", 0, "deeper"),
]


@pytest.mark.parametrize(("line", "code", "column", "words"), LINES)
def test_a_wrong_line_is_explained(line: str, code: str, column: int, words: str) -> None:
    """Code, column, the text that was found, the right form."""
    with pytest.raises(AsSyntaxError) as caught:
        parse(f".PROGRAM p\n{line}\n.END", "f.as")
    mistake = caught.value.mistakes[0]
    assert (mistake.code, mistake.column, mistake.where.line) == (code, column, 2)
    assert words in str(mistake)
    assert str(mistake).startswith("f.as:2")


def test_a_file_is_read_from_disk_byte_by_byte(tmp_path: Path) -> None:
    """One byte is one character, whatever the file's encoding was."""
    path = tmp_path / "x.as"
    path.write_bytes(b'.PROGRAM p\n$s = "\xff\xe4" ; \xd0\x9f\n.END')
    assert len(load(path).programs["p"].steps) == 1


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    """With the reason."""
    with pytest.raises(DataError, match=r"missing\.as: cannot be read: No such file"):
        load(tmp_path / "missing.as")

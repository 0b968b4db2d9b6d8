"""`--check`: lines that cannot be executed, and the traps of facts section 5."""

from pathlib import Path

import pytest

from sim.as_language.lint import check_text
from sim.controller.__main__ import main

CALLS_H = ".PROGRAM q\nCALL h\n.END\n.PROGRAM h\n.END\n"
CLEAN = ".PROGRAM p()\nx = 1\nPRINT x\n.END\n"


def rules(*lines: str, more: str = "") -> list[str]:
    """The rules that a program of these lines breaks."""
    report = check_text("\n".join([".PROGRAM p", *lines, ".END", more]))
    assert not report.mistakes
    return sorted({finding.rule for finding in report.findings})


SNIPPETS = [
    (["GUNON 1,5"], ["instruction"]),
    (["x = NOFUNC(1)"], ["function"]),
    (["POINT/EXT p = NULL"], ["instruction"]),
    (["PRINT /Q1,2"], ["format"]),
    (["x = ABS(1,2)"], ["P0101"]),
    (["a_very_long_name = 1"], ["long-name"]),
    (["a_very_long_name1 = 1", "a_very_long_name2 = 2"], ["long-name", "same-name"]),
    (["x = 1", "y = NOT x == 2"], ["not-relation"]),
    (["x = 1", "y = NOT (x == 2)"], []),
    (["x = 1", "y = (x != 2)"], ["not-equal"]),
    (["x = 1", "y = 7 % x"], ["percent"]),
    (['$s = "%"', "x = 7 MOD 2"], []),
    (["x = 1", "CASE x", "VALUE 1:", "ANY", "END"], ["left-out"]),
    (["x.then = 1", "IF x.then", "END"], ["left-out"]),
    (["POINT p"], ["instruction", "never-defined"]),
    (["x = 1 ; \xe4"], ["non-ascii"]),
    (["x = 1 ;" + "c" * 100], ["long-line"]),
    (["$s = $ENCODE(/K6,1)"], ["optional-format"]),
    (["f = TRUE", "IF f == 1 THEN", "END"], ["true-is-minus-1"]),
    (["IF SIG(1) == 1 THEN", "END"], ["true-is-minus-1"]),
    (['x = VAL("")'], ["val"]),
    (['x = VAL("12a")'], []),
    (['$a = "x"', "x = ($a + $a == $a)"], ["text-relation"]),
    (['$a = "x"', "x = (($a + $a) == $a)"], []),
    (["GOTO nowhere"], ["E0101"]),
    (['$s = ""', "CASE $s OF", "END"], ["text-case"]),
    (["x = 1", "CASE x OF", "ANY:", "END"], ["any-label"]),
    (["TCP_RECV r,1,$s[1],n,0.1"], ["tcp-timeout"]),
    (["TCP_LISTEN r,80"], ["tcp-port"]),
    (["x = y"], ["never-defined"]),
    (["y = x+a[3]", ".END", ".REALS", "x = 1", "a[3] = 1"], []),
    (["x = 1", "x[1] = 2"], ["scalar-and-array"]),
    (["x = 1", "POINT x = NULL"], ["two-types"]),
    (["speed = 1"], ["reserved"]),
    (["CALL missing"], ["no-program"]),
    (["CALL p(1)"], ["P0137"]),
]


@pytest.mark.parametrize(("lines", "expected"), SNIPPETS)
def test_each_trap_is_found_and_only_that_one(lines: list[str], expected: list[str]) -> None:
    """A rule per trap; the same thing written well is silent."""
    assert rules(*lines) == expected


@pytest.mark.parametrize(
    ("lines", "more", "expected"),
    [
        (["PCEXECUTE 1: q", "CALL h"], CALLS_H, ["shared-program"]),
        (["PCEXECUTE 1: q", "PCEXECUTE 2: r"],
         f"{CALLS_H}.PROGRAM r\nCALL g\n.END\n.PROGRAM g\nCALL h\n.END", ["shared-program"]),
        (["PCEXECUTE 1: q", "CALL h"],
         ".PROGRAM q\nCALL g\n.END\n.PROGRAM g\n.END\n.PROGRAM h\n.END", []),
        (["PCEXECUTE 1: q"], ".PROGRAM q\nLMOVE HERE\n.END", ["E1095"]),
        (["PCEXECUTE 1: q"], ".PROGRAM q\nCALL h\n.END\n.PROGRAM h\nJMOVE #HERE\n.END", ["E1095"]),
        (["PCEXECUTE 1: q"], ".PROGRAM q\nPOINT t = TOOL\n.END", ["pc-frame"]),
        (["PCEXECUTE 1: q"], ".PROGRAM q\nBRAKE\n.END", []),
        (["CALL q($s)", '$s = "a"'], ".PROGRAM q(.x)\ny = .x\n.END", ["P0138"]),
        (["CALL a_very_long_name"], ".PROGRAM a_very_long_name\n.END", ["long-name", "remark"]),
    ],
)  # fmt: skip
def test_traps_between_programs_are_found(lines: list[str], more: str, expected: list[str]) -> None:
    """Shared helpers of two tasks (P1014), motion in PC programs, calls that do not fit."""
    assert rules(*lines, more=more) == expected


@pytest.mark.parametrize(
    ("text", "options", "code", "words"),
    [
        (CLEAN, [], 0, "1 programs, 2 steps, 0 data values, 0 skipped sections, 0 mistakes"),
        (CLEAN, ["--strict"], 0, "0 warnings"),
        (CLEAN.replace("= 1", "= y"), [], 0, "[never-defined]"),
        (CLEAN.replace("= 1", "= y"), ["--strict"], 1, "strict: findings are errors"),
        (CLEAN.replace("= 1", "="), [], 2, "(P0108) Syntax error: found the end of the line"),
        (CLEAN + ".SYSDATA\nA 1\n.END", [], 0, ":5: skipped: section .SYSDATA"),
    ],
)
def test_the_exit_code_reports_whether_the_file_parses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, options: list[str], code: int,
    words: str,
) -> None:  # fmt: skip
    """0 when it parses, 2 when not, 1 for findings in strict mode."""
    path = tmp_path / "f.as"
    path.write_text(text)
    assert main(["--check", *options, str(path)]) == code
    assert words in capsys.readouterr().out


def test_the_shipped_program_is_clean() -> None:
    """controller/forcemesh.as has no finding at all."""
    path = Path(__file__).resolve().parents[4] / "controller" / "forcemesh.as"
    report = check_text(path.read_bytes().decode("latin-1"), path.name)
    assert not report.mistakes
    assert [str(finding) for finding in report.findings] == []

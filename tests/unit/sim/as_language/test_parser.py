"""Statements of AS: the statement of each line (facts 1.2, 1.5, 1.9)."""

import pytest

from sim.as_language import syntax
from sim.as_language.lines import parse_line
from sim.as_language.syntax import (
    Binary,
    Format,
    FunctionCall,
    Instruction,
    JointLiteral,
    Number,
    Print,
    Text,
    Unary,
    Variable,
    Word,
)  # fmt: skip
from tests.fakes.as_language import expression, statement

ONE, TWO = Number(1.0), Number(2.0)
X, P = Variable("", "x"), Variable("", "p")

INSTRUCTIONS = [
    ("JMOVE p", Instruction("JMOVE", (P,))),
    ("LMOVE p,2", Instruction("LMOVE", (P, TWO))),
    ("LMOVE p+x", Instruction("LMOVE", (Binary("+", P, X),))),
    ("JMOVE #[1,2]", Instruction("JMOVE", (JointLiteral((ONE, TWO)),))),
    ("LMOVE SHIFT(p BY 1,,2)",
     Instruction("LMOVE", (FunctionCall("SHIFT", (P, ONE, None, TWO)),))),
    ("JAPPRO p,x", Instruction("JAPPRO", (P, X))),
    ("SPEED 2", Instruction("SPEED", (TWO,))),
    ("SPEED x MM/S ALWAYS", Instruction("SPEED", (X,), ("MM/S", "ALWAYS"))),
    ("SPEED 1 MM/MIN", Instruction("SPEED", (ONE,), ("MM/MIN",))),
    ("SPEED 2 S", Instruction("SPEED", (TWO,), ("S",))),
    ("SPEED 2 MM/S,1 DEG/S ALWAYS", Instruction("SPEED", (TWO, ONE), ("MM/S", "DEG/S", "ALWAYS"))),
    ("ACCURACY 1 ALWAYS FINE", Instruction("ACCURACY", (ONE,), ("ALWAYS", "FINE"))),
    ("BREAK", Instruction("BREAK")),
    ("TOOL NULL", Instruction("TOOL", (FunctionCall("NULL"),))),
    ("SIGNAL 1,-2", Instruction("SIGNAL", (ONE, Unary("-", TWO)))),
    ("WAIT x", Instruction("WAIT", (X,))),
    ("TIMER 1 = 2", Instruction("TIMER", (ONE, TWO))),
    ("TIMER (1)=2", Instruction("TIMER", (ONE, TWO))),
    ("BITS 1,2 = x", Instruction("BITS", (ONE, TWO, X))),
    ("CP ON", Instruction("SWITCH", (Word("cp"),), ("ON",))),
    ("prefetch.sigins off", Instruction("SWITCH", (Word("prefetch.sigins"),), ("OFF",))),
    ("CP, QTOOL OFF", Instruction("SWITCH", (Word("cp"), Word("qtool")), ("OFF",))),
    ("RTC_SW 1: ON", Instruction("SWITCH", (Word("rtc_sw"),), ("1:", "ON"))),
    ("POINT p", Instruction("POINT", (P,))),
    ("POINT/X p", Instruction("POINT", (P,), ("/X",))),
    ("PCEXECUTE 2: p.a,-1",
     Instruction("PCEXECUTE", (TWO, Word("p.a"), Unary("-", ONE)))),
    ("PCEXECUTE p", Instruction("PCEXECUTE", (ONE, Word("p")))),
    ("PCABORT 2:", Instruction("PCABORT", (TWO,))),
    ("PCEND", Instruction("PCEND", (ONE,))),
    ("MC EXECUTE p,2", Instruction("MC EXECUTE", (Word("p"), TWO))),
    ("MC SPEED 2", Instruction("MC SPEED", (TWO,))),
    ("MC SPEED 2: 1", Instruction("MC SPEED", (ONE,), ("2:",))),
    ("MC ZPOWER ON", Instruction("MC ZPOWER", (Number(-1.0),))),
    ("MC HOLD", Instruction("MC HOLD")),
    ("ONE p", Instruction("ONE", (Word("p"),))),
    ("ON 1 CALL p,2", Instruction("ON", (ONE, Word("p"), TWO), ("CALL",))),
    ("ON 1 GOTO 10,2", Instruction("ON", (ONE, Word("10"), TWO), ("GOTO",))),
    ("DELETE/R x", Instruction("DELETE", (X,), ("/R",))),
    ("SETHOME 1,#j", Instruction("SETHOME", (ONE, Variable("#", "j")))),
    ("ONI/ERR 1 GOTO 10", Instruction("ONI", (ONE, Word("10")), ("/ERR", "GOTO"))),
    ("XMOVE/LVL p TILL 2", Instruction("XMOVE", (P, TWO), ("/LVL", "TILL"))),
    ("TCP_RECV x,1,$s[2],p,1", Instruction("TCP_RECV", (
        X, ONE, Variable("$", "s", indices=(TWO,)), P, ONE))),
    ('PRINT 2: /S,"a",x', Print("PRINT", (Format("S"), Text("a"), X), TWO)),
    ("TYPE /F5.2,x", Print("TYPE", (Format("F", 5, 2), X))),
    ("PRINT", Print("PRINT")),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), INSTRUCTIONS)
def test_each_instruction_becomes_its_name_arguments_and_words(
    text: str, expected: syntax.Statement
) -> None:
    """Full upper-case names, whatever the case of the line."""
    assert statement(text) == expected
    if '"' not in text:
        assert statement(text.lower()) == expected


STATEMENTS = [
    ("x = 1", syntax.Assign(X, ONE)),
    ("POINT p = x", syntax.PointStatement(P, X)),
    ("POINT/OAT p = x", syntax.PointStatement(P, X, "OAT")),
    ("POINT/X p = x", syntax.PointStatement(P, X, "X")),
    ("POINT/7 p = x", syntax.PointStatement(P, X, "7")),
    ("POINT p+x+q = p",
     syntax.PointStatement(Variable("", "q"), P, relative_to=Binary("+", P, X))),
    ("POINT #j = p,#k", syntax.PointStatement(Variable("#", "j"), P, "", Variable("#", "k"))),
    ("HERE #j", syntax.Here(Variable("#", "j"))),
    ("HERE p+x+q", syntax.Here(Variable("", "q"), Binary("+", P, X))),
    ("DECOMPOSE x[2] = #HERE",
     syntax.Decompose(Variable("", "x", indices=(TWO,)), FunctionCall("#HERE"))),
    ("IF x GOTO 10", syntax.Goto("10", X)),
    ("GOTO out IF x", syntax.Goto("out", X)),
    ("GOTO 10", syntax.Goto("10")),
    ("FOR x = 1 TO 2", syntax.For(X, ONE, TWO, ONE)),
    ("FOR .i = 1 TO 2 STEP x", syntax.For(Variable("", "i", local=True), ONE, TWO, X)),
    ("SCASE $s OF", syntax.CaseStatement(Variable("$", "s"), text=True)),
    ("VALUE 1,2 :", syntax.Value((ONE, TWO))),
    ("ANY :", syntax.Any()),
    ("CALL p", syntax.CallStatement("p")),
    ("CALL p()", syntax.CallStatement("p")),
    ("CALL p(1,,x)", syntax.CallStatement("p", (ONE, None, X))),
    ("CALL p(&x)", syntax.CallStatement("p", (syntax.Reference(X),))),
    ("CALL p(.&x[,])",
     syntax.CallStatement("p", (syntax.Reference(Variable("", "x", local=True, whole=True)),))),
    ("SCALL $s,x", syntax.Scall(Variable("$", "s"), X)),
    ("RETURN", syntax.Return()),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), STATEMENTS)
def test_each_statement_becomes_its_own_value(text: str, expected: syntax.Statement) -> None:
    """Targets are not resolved before the program is whole."""
    assert statement(text) == expected


@pytest.mark.parametrize(
    ("text", "label", "there"),
    [("10 x = 1", "10", True), ("out:", "out", False), ("out: x = 1", "out", True),
     ("10", "10", False), ("ANY:", "any", False), ("ANY :", None, True), ("10: x = 1", "10", True)],
)  # fmt: skip
def test_labels_stand_before_the_instruction(text: str, label: str | None, there: bool) -> None:
    """A number without colon or a name with one; ANY: without the blank is a label too."""
    line = parse_line(text)
    assert line.label == label
    assert (line.statement is not None) == there


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


def test_a_line_of_an_unknown_instruction_is_kept_unread() -> None:
    """Options of a real backup: no list of arguments, and no reason to refuse the file."""
    found = statement("  WELD JOB9 WIRE= (OFF,0,O) #[36.46,37.6] ;")
    assert found == Instruction("WELD", (Text("JOB9 WIRE= (OFF,0,O) #[36.46,37.6] ;"),),
                                unknown=True)  # fmt: skip


@pytest.mark.parametrize("word", ["JOINT", "linear", "CIR1", "CIR2"])
@pytest.mark.parametrize(
    "rest",
    ["SPEED9 ACCU1 TIMER0 TOOL1 WORK0 CLAMP1 (OFF,0,0,O) 2 (ON,0,0,C) OX= WX= #[1,-2.5,3] ;up",
     "30.0 ACCU1 TIMER0 TOOL1 WORK0 CLAMP OX=84,-85 WX=1001 #[1,2,3,4,5,6,-2000]",
     "SPEED3 ACCU1 TIMER0 TOOL1 WORK0 GROUP0  CLAMP1 (OFF,0,0,O) OX= WX=  YO=^H0,^H0 #[1,2]"],
)  # fmt: skip
def test_a_block_step_of_the_pendant_is_known_and_kept_unread(word: str, rest: str) -> None:
    """With clamps, signals and values of further axes; a label may stand before it."""
    assert statement(f"  {word} {rest}") == Instruction(word.upper(), (Text(rest),))
    assert parse_line(f"10 {word} {rest}").label == "10"


@pytest.mark.parametrize("line", ["joint = 1", "JOINT SPEED9 ACCU1", "CALL joint", "cir1[2] = 3"])
def test_the_words_of_block_steps_are_names_elsewhere(line: str) -> None:
    """Without joint values it is an unknown instruction at most."""
    found = statement(line)
    assert not isinstance(found, Instruction) or found.unknown


@pytest.mark.parametrize(
    ("short", "full"),
    [("IF x == 1", "IF x == 1 THEN"), ("WHILE SIG(-1)", "WHILE SIG(-1) DO"),
     ("CASE x", "CASE x OF"), ("SCASE $s", "SCASE $s OF"), ("VALUE 1,2", "VALUE 1,2:"),
     ('SVALUE "a"', 'SVALUE "a":'), ("ANY", "ANY :")],
)  # fmt: skip
def test_words_at_the_end_of_a_line_may_be_left_out(short: str, full: str) -> None:
    """Public programs, also generated ones, are written so; of ANY the manual states it."""
    assert statement(short) == statement(full)


def test_an_unknown_instruction_with_arguments_is_parsed_and_marked() -> None:
    """The check lists it; executing it is an error."""
    assert statement("WIBBLE 1,x") == Instruction("WIBBLE", (ONE, X), unknown=True)
    monitor_command = statement("MC DIRECTORY 1")
    assert isinstance(monitor_command, Instruction)
    assert monitor_command.unknown

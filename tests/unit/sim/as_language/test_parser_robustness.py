"""No content of a file makes the parser or the check fail, except with a message."""

from hypothesis import given, settings
from hypothesis import strategies as st

from sim.as_language.errors import TEXTS, AsError
from sim.as_language.lint import check_text
from sim.as_language.parser import KINDS
from tests.fakes.as_bench import AsBench, program
from tests.unit.sim.as_language.conftest import AsLanguage

SPELLED = """
    IF THEN ELSE END WHILE DO UNTIL FOR TO STEP CASE OF VALUE ANY : GOTO CALL RETURN x .y $s .$t
    #j @n a[1] a[ ] ( ) , + - * / ^ = == <> < > AND OR NOT MOD BAND 1 2.5 1E9 ^B1 ^HF 'A "t" " ;
    JMOVE SPEED MM/S ALWAYS PRINT /F5.2 /S $ENCODE( LEN( SHIFT( BY TRANS( #[ & TIMER ON OFF CP
    PCEXECUTE 2: MC EXECUTE XMOVE TILL POINT /OAT HERE #HERE DECOMPOSE WIBBLE .END .PROGRAM p(
    % ON ONI SOUT PROMPT C1MOVE JOINT LINEAR STRTOPOS( EXISTDATA( SYSDATA( UTIMER( IFPWPRINT
    .REALS .TRANS .STRINGS 10 out: $DECODE( MAXINDEX( EXISTREAL( SWITCH( TCP_RECV ONE ONI SCALL
"""
WORDS = st.sampled_from(SPELLED.split())
LINES = st.lists(WORDS, max_size=12).map(" ".join)
CONTROLLER = AsBench(program("PAUSE")).task.machine
NOISE = st.text(st.characters(max_codepoint=255), max_size=40)
FILES = st.lists(st.one_of(LINES, NOISE), max_size=12).map("\n".join)


@settings(max_examples=300)
@given(st.sampled_from([".PROGRAM p", "", *sorted(KINDS)]), FILES)
def test_every_file_can_be_checked(head: str, body: str) -> None:
    """The report holds mistakes or findings; both can be printed."""
    report = check_text(f"{head}\n{body}\n.END")
    for item in (*report.mistakes, *report.findings):
        assert str(item)
    assert all(mistake.code in TEXTS for mistake in report.mistakes)
    assert report.exit_code(strict=False) in {0, 2}


@settings(max_examples=300)
@given(LINES)
def test_a_parsed_expression_has_a_value_or_an_error_of_as(words: str) -> None:
    """No Python exception reaches the user who runs a program."""
    defined = ("x = 1", ".y = 2", '$s = "a"', '.$t = "1"', "@n = 3", "a[1] = 4")
    bench = AsLanguage(*defined, machine=CONTROLLER)
    try:
        value = bench(words)
    except (AsError, AssertionError):
        return
    assert value is not None

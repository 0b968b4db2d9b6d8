"""No content of a file makes the parser or the check fail, except with a message."""

from collections.abc import Callable
from functools import partial

from hypothesis import example, given, settings
from hypothesis import strategies as st

from sim.as_language.errors import TEXTS, AsError, AsSyntaxError
from sim.as_language.lines import parse_line
from sim.as_language.lint import check_text
from sim.as_language.parser import KINDS, parse
from tests.fakes.as_bench import AsBench, program
from tests.fakes.as_language import AsLanguage

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


def refusal(read: Callable[[], object]) -> Exception | None:
    """Return the error with which something is refused; any other exception fails the test."""
    try:
        read()
    except (AsError, AsSyntaxError) as error:
        return error
    return None


@settings(max_examples=300)
@example("\nA")
@given(st.one_of(LINES, NOISE))
def test_a_line_is_parsed_or_explained(line: str) -> None:
    """AsError with a code and a sentence is the only failure."""
    error = refusal(lambda: parse_line(line))
    assert error is None or (isinstance(error, AsError) and error.code in TEXTS and error.detail)


@given(st.binary(max_size=200))
def test_random_bytes_are_parsed_or_explained(data: bytes) -> None:
    """As a whole file and as the body of a program."""
    for text in (data.decode("latin-1"), f".PROGRAM p\n{data.decode('latin-1')}\n.END"):
        error = refusal(partial(parse, text))
        assert error is None or (isinstance(error, AsSyntaxError) and error.mistakes)


@given(FILES)
def test_every_file_can_be_checked(body: str) -> None:
    """The report holds mistakes or findings; both can be printed."""
    report = check_text(f".PROGRAM p\n{body}\n.END")
    for item in (*report.mistakes, *report.findings):
        assert str(item)
    assert report.exit_code(strict=False) in {0, 2}


@given(st.sampled_from(sorted(KINDS)), NOISE)
def test_every_data_section_is_read_or_explained(section: str, line: str) -> None:
    """Whatever stands in it."""
    error = refusal(lambda: parse(f"{section}\n{line}\n.END"))
    assert error is None or (isinstance(error, AsSyntaxError) and error.mistakes)


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

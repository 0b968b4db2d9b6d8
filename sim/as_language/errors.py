"""AS errors: mistakes in a file, and run-time errors of a program, with Kawasaki's codes.

Texts follow appendix 4 of the AS Language Reference Manual.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from forcemesh.errors import ForcemeshError
from sim.as_language.syntax import Position

TEXTS = dict(
    line.split(" ", 1)
    for line in """\
P0100 Illegal input data
P0101 Too many arguments
P0104 Illegal robot number
P0108 Syntax error
P0109 Invalid statement
P0111 Cannot use in this mode
P0113 Not a program instruction
P0114 Illegal expression
P0115 Illegal function
P0116 Illegal argument of function
P0117 Invalid variable (or program) name
P0118 Illegal variable type
P0119 Incorrect array suffix
P0120 Unbalanced parentheses
P0121 Binary operator expected
P0132 Not an array variable
P0133 Array variable: its elements need an index
P0137 Wrong number of arguments
P0138 Argument types do not match
P0140 Structure is not closed by END
P0141 END without a structure
P0142 ELSE without IF
P0143 UNTIL without DO
P0144 DO is not closed by UNTIL
P0145 VALUE or ANY outside of CASE
P0146 Label is defined twice
P0147 Structures overlap
P0150 Variable is of another type
P0151 Program does not exist
P1000 Motor power is off
P1001 Teach mode
P1002 Teach lock is on
P1009 A program is running already
P1011 Cannot continue this program. Use EXECUTE
P1013 Cannot execute in error state
P1014 Program is already in use
P1019 PC program is running
E0101 Nonexistent label
E0102 Variable is not defined
E0103 Location is not defined
E0104 String variable is not defined
E0105 Program or label does not exist
E0106 Value is out of range
E0107 No array suffix
E0108 Division by zero
E0109 Floating point overflow
E0110 String is too long
E0111 Cannot execute an instruction that is not supported
E0112 CALL is nested too deep
E1070 ON/ONI signal is already input
E1071 XMOVE signal is already input
E1075 Illegal clamp number
E1095 Cannot execute motion instruction in PC program
E1097 Missing C1MOVE or C2MOVE instruction
E1098 C1MOVE instruction required before C2MOVE
E1099 Unable to create arc path, check positions of the 3 points
E1117 Process time over
E1184 Illegal configuration for motion
E4007 Receiving data is too long (MAX=255 characters)
E4012 Waiting for input of PROMPT. Connect input device
E4019 Socket open failure
E4020 Socket close failure
E4021 Communication error
E4022 Message is too long
E4023 Cannot reach the host
E4024 Communication time out error
E4025 Connection aborted
E4026 No buffer space
E4027 Bad socket
E4054 Ethernet board is not installed
E4055 Cannot create a socket
E4056 Port is not in LISTEN
E4057 Illegal socket ID
E6007 Position is out of the motion range
E6008 Cannot be reached in this posture
E6016 Cannot move through a singular point""".splitlines()
)
# Numbers of the manual; codes that only this emulator uses are listed in docs/as-emulator.md
# ("codes of our own").


class SyntaxMistake(NamedTuple):
    """One mistake in a file: position, code, the text found and the text expected."""

    where: Position
    code: str
    text: str
    column: int = 0

    def __str__(self) -> str:
        column = f":{self.column}" if self.column else ""
        return f"{self.where}{column}: ({self.code}) {TEXTS[self.code]}: {self.text}"


class AsSyntaxError(ForcemeshError):
    """Error: a file is not valid AS. `mistakes` lists all mistakes found."""

    def __init__(self, mistakes: tuple[SyntaxMistake, ...]) -> None:
        """Put one mistake on each line."""
        self.mistakes = mistakes
        super().__init__("\n".join(str(mistake) for mistake in mistakes))


class AsError(ForcemeshError):
    """Error of one line, or run-time error of a program. `code` is the AS code, such as "E0102"."""

    def __init__(self, code: str, detail: str = "", column: int = 0) -> None:
        """Store the code for ERROR and $ERROR, the detail for the message, the column (from 1)."""
        self.code, self.detail, self.column = code, detail, column
        super().__init__(f"({code}) {error_text(code)}{': ' if detail else ''}{detail}")

    @property
    def number(self) -> int:
        """Return the value of the ERROR function: -3xxxx for E, -1xxxx for P codes."""
        return -(_BASES[self.code[0]] + int(self.code[1:]))


def refuse(code: str, detail: str) -> Callable[[object], Any]:
    """Return a reader of a value, or a step of a program, that raises when it is executed."""

    def run(_: object) -> Any:
        raise AsError(code, detail)

    return run


_BASES = {"P": 10000, "W": 20000, "E": 30000, "D": 40000}


def code_of(number: int) -> str | None:
    """Return the code for a number of ERROR or of a TCP result: -34024 is "E4024"."""
    for letter, base in _BASES.items():
        if base <= -number < base + 10000:
            return f"{letter}{-number - base:04d}"
    return None


def error_text(code: str) -> str:
    """Return the text for a code; "Error" for an unknown code."""
    return TEXTS.get(code, "Error")

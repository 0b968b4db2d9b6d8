"""AS errors: mistakes in a file, and run-time errors of a program, with Kawasaki's codes.

Texts and numbers are those of controller.error_codes, and for what only a file or this emulator can
do wrong those below.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from controller.error_codes import ERROR_TEXTS, number_of
from forcemesh.errors import ForcemeshError
from sim.as_language.syntax import SourcePosition

TEXTS = ERROR_TEXTS | dict(
    line.split(" ", 1)
    for line in """\
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
E0105 Program or label does not exist
E0107 No array suffix
E0109 Floating point overflow
E0111 Cannot execute an instruction that is not supported
E0112 CALL is nested too deep""".splitlines()
)
# Numbers of the manual; codes that only this emulator uses are listed in docs/as-emulator.md
# ("codes of our own").


class SyntaxMistake(NamedTuple):
    """One mistake in a file: position, code, the text found and the text expected."""

    where: SourcePosition
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
        return number_of(self.code)


def refuse(code: str, detail: str) -> Callable[[object], Any]:
    """Return a reader of a value, or a step of a program, that raises when it is executed."""

    def run(_: object) -> Any:
        raise AsError(code, detail)

    return run


def error_text(code: str) -> str:
    """Return the text for a code; "Error" for an unknown code."""
    return TEXTS.get(code, "Error")

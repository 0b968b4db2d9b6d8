"""String functions of AS (reference manual, chapter 9). Choices: docs/as-emulator.md."""

import re
from collections.abc import Sequence

from sim.as_language.errors import AsError, code_of, error_text
from sim.as_language.functions import Argument, function, string, table, whole
from sim.as_language.machine_api import MachineInterface
from sim.as_language.values import single, text

DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([Ee][+-]?\d+)?", re.ASCII)
DIGITS = {1: re.compile(r"[01]+"), 2: re.compile(r"[0-9A-Fa-f]+")}
BASES = {1: 2, 2: 16}


def left(characters: str, count: int) -> str:
    """Return the first characters; all of them if there are fewer."""
    return characters[: max(count, 0)]


def right(characters: str, count: int) -> str:
    """Return the last characters; all of them if there are fewer."""
    return characters[-count:] if count > 0 else ""


def middle(characters: str, start: int, count: int | None) -> str:
    """Return `count` characters from the 1-based start; "" if it lies outside of the string."""
    if start < 1:
        return ""
    end = None if count is None else start - 1 + max(count, 0)
    return characters[start - 1 : end]


def position(start: int, characters: str, text: str) -> int:
    """Return the 1-based position of a string, 0 if not found; case-insensitive."""
    start = max(start, 1)
    if start > len(characters):
        return 0
    if not text:
        return start
    return characters.lower().find(text.lower(), start - 1) + 1


def value_of(characters: str, code: int) -> float:
    """Parse the number at the start of a string: 0 decimal, 1 binary, 2 hexadecimal; 0 if none."""
    rest = characters.lstrip(" ")
    prefix = rest[:2].upper()
    if prefix in {"^B", "^H"}:
        code, rest = (1 if prefix == "^B" else 2), rest[2:]
    if code in BASES:
        found = DIGITS[code].match(rest)
        return single(float(int(found[0], BASES[code]))) if found else 0.0
    if code != 0:
        raise AsError("P0116", f"VAL: the code is 0, 1 or 2, not {code}")
    found = DECIMAL.match(rest)
    return single(float(found[0])) if found else 0.0


def decode(characters: str, separator: str, mode: float) -> tuple[str, str]:
    """Return the result of $DECODE and the text left in the variable.

    Mode up to 0: the text before the separator (all text without one). Mode above 0: all
    consecutive separators at the start.
    """
    low, mark = characters.lower(), separator.lower()
    if mode > 0.0:
        end = 0
        while mark and low.startswith(mark, end):
            end += len(mark)
    else:
        found = low.find(mark) if mark else -1
        end = len(characters) if found < 0 else found
    return characters[:end], characters[end:]


def _asc(_: MachineInterface, a: Sequence[Argument]) -> float:
    characters, place = string(a[0]), max(whole(a[1], 1) if len(a) > 1 else 1, 1)
    return float(ord(characters[place - 1])) if place <= len(characters) else -1.0


def _chr(_: MachineInterface, a: Sequence[Argument]) -> str:
    code = whole(a[0])
    if not 0 <= code <= 255:
        raise AsError("E0106", f"$CHR({code}): codes are 0 to 255")
    return chr(code)


def _mid(_: MachineInterface, a: Sequence[Argument]) -> str:
    count = None if len(a) < 3 or a[2] is None else whole(a[2])
    return middle(string(a[0]), whole(a[1], 1) if len(a) > 1 else 1, count)


def _instr(_: MachineInterface, a: Sequence[Argument]) -> float:
    if isinstance(a[0], str):
        if len(a) > 2:
            raise AsError("P0116", "INSTR takes (start,string,wanted) or (string,wanted)")
        return float(position(1, a[0], string(a[1])))
    if len(a) < 3:
        raise AsError("P0116", "INSTR takes (start,string,wanted) or (string,wanted)")
    return float(position(whole(a[0], 1), string(a[1]), string(a[2])))


def _val(_: MachineInterface, a: Sequence[Argument]) -> float:
    return value_of(string(a[0]), whole(a[1]) if len(a) > 1 else 0)


def _error(_: MachineInterface, a: Sequence[Argument]) -> str:
    code = code_of(whole(a[0]))
    return f"({code}){error_text(code)}" if code else ""


def _errors(_: MachineInterface, a: Sequence[Argument]) -> str:
    return error_text(string(a[0]).strip().upper())


FUNCTIONS = table(
    function("LEN", "s", lambda _, a: float(len(string(a[0])))),
    function("ASC", "s(r)", _asc),
    function("$CHR", "r", _chr),
    function("$SPACE", "r", lambda _, a: text(" " * min(max(whole(a[0]), 0), 256))),
    function("$LEFT", "sr", lambda _, a: left(string(a[0]), whole(a[1]))),
    function("$RIGHT", "sr", lambda _, a: right(string(a[0]), whole(a[1]))),
    function("$MID", "s(rr)", _mid),
    function("INSTR", "xs(s)", _instr),
    function("VAL", "s(r)", _val),
    function("$ERROR", "r", _error),
    function("$ERRORS", "s", _errors),
    function("$DATE", "(r)", lambda machine, _: machine.date()),
    function("$TIME", "(r)", lambda machine, _: machine.time()),
)

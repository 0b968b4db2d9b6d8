"""String functions of AS (reference manual, chapter 9). Choices: docs/as-emulator.md."""

import re

from sim.as_language.errors import AsError, code_of, error_text
from sim.as_language.functions import function
from sim.as_language.values import single, text

DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([Ee][+-]?\d+)?", re.ASCII)
DIGITS = {1: re.compile(r"[01]+"), 2: re.compile(r"[0-9A-Fa-f]+")}
BASES = {1: 2, 2: 16}


def right(characters: str, count: float) -> str:
    """$RIGHT($s,n): the last characters; all of them if there are fewer."""
    return characters[-int(count) :] if int(count) > 0 else ""


def middle(characters: str, start: float = 1.0, count: float | None = None) -> str:
    """$MID($s,start,n): from the 1-based start; "" if it lies outside of the string."""
    first = int(start) - 1
    if first < 0:
        return ""
    return characters[first:] if count is None else characters[first : first + max(int(count), 0)]


def position(start: int, characters: str, text: str) -> int:
    """Return the 1-based position of a string, 0 if not found; case-insensitive."""
    start = max(start, 1)
    if start > len(characters):
        return 0
    if not text:
        return start
    return characters.lower().find(text.lower(), start - 1) + 1


def value_of(characters: str, code: float = 0.0) -> float:
    """VAL($s,code): the number at the start: 0 decimal, 1 binary, 2 hexadecimal; 0 if none."""
    rest, base = characters.lstrip(" "), int(code)
    prefix = rest[:2].upper()
    if prefix in {"^B", "^H"}:
        base, rest = (1 if prefix == "^B" else 2), rest[2:]
    if base in BASES:
        found = DIGITS[base].match(rest)
        return single(float(int(found[0], BASES[base]))) if found else 0.0
    if base != 0:
        raise AsError("P0116", f"VAL: the code is 0, 1 or 2, not {base}")
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


def code_at(characters: str, place: float = 1.0) -> float:
    """ASC($s,n): the code of a character, -1 behind the end."""
    at = max(int(place), 1)
    return float(ord(characters[at - 1])) if at <= len(characters) else -1.0


def character(code: float) -> str:
    """$CHR(n)."""
    if not 0 <= int(code) <= 255:
        raise AsError("E0106", f"$CHR({int(code)}): codes are 0 to 255")
    return chr(int(code))


def instr(first: float | str, second: str, third: str | None = None) -> float:
    """INSTR(start,string,wanted) and INSTR(string,wanted)."""
    if isinstance(first, str) == (third is not None):
        raise AsError("P0116", "INSTR takes (start,string,wanted) or (string,wanted)")
    if isinstance(first, str):
        return float(position(1, first, second))
    return float(position(int(first), second, third or ""))


def error_of(number: float) -> str:
    """$ERROR(n): code and text of an error number."""
    code = code_of(int(number))
    return f"({code}){error_text(code)}" if code else ""


FUNCTIONS = {
    "LEN": function("s", lambda characters: float(len(characters))),
    "ASC": function("sr", code_at),
    "$CHR": function("r", character),
    "$SPACE": function("r", lambda count: text(" " * min(max(int(count), 0), 256))),
    "$LEFT": function("sr", lambda characters, count: characters[: max(int(count), 0)]),
    "$RIGHT": function("sr", right),
    "$MID": function("srr", middle),
    "INSTR": function("xss", instr),
    "VAL": function("sr", value_of),
    "$ERROR": function("r", error_of),
    "$ERRORS": function("s", lambda code: error_text(code.strip().upper())),
    "$DATE": function("mr", lambda machine, _=0.0: machine.date()),
    "$TIME": function("mr", lambda machine, _=0.0: machine.time()),
}

"""Text formatting of $ENCODE, PRINT and TYPE (reference manual 5-111, 5-112, 9-70).

A format applies to the items after it. /J /K /L are options of the controller and rejected unless
`optional` is set. Choices where the manual is ambiguous are listed in docs/as-emulator.md.
"""

from collections.abc import Callable, Sequence

from sim.as_language.errors import AsError
from sim.as_language.functions_number import rounded
from sim.as_language.machine_api import EvaluationContext
from sim.as_language.syntax import Format
from sim.as_language.values import NUMBER
from sim.as_language.variables import Read

DEFAULT = Format("D")
OPTIONAL = frozenset("JKL")
NUMERIC = frozenset("DEFGHIJKL")
SIGNIFICANT = 8
SPACES = {"X": " ", "C": "\n"}


def layout(
    items: Sequence[Read | Format], *, optional: bool
) -> Callable[[EvaluationContext], tuple[str, bool]]:
    """Compile items to their text, and whether a line feed follows (not after /S)."""
    current = DEFAULT
    parts: list[Callable[[EvaluationContext], str]] = []
    for item in items:
        if not isinstance(item, Format):
            parts.append(_written(item, current))
        elif item.code in OPTIONAL and not optional:
            text = f"/{item.code} is an option of the controller that is not installed"
            parts.append(_refused(f"{text}; pad by hand, or enable the emulator's option"))
        elif item.code in NUMERIC:
            current = item
        elif item.code != "S":
            parts.append(_space(item))
    feed = not any(isinstance(item, Format) and item.code == "S" for item in items)
    if len(parts) == 1:
        only = parts[0]
        return lambda context: (only(context), feed)
    return lambda context: ("".join([part(context) for part in parts]), feed)


def _refused(reason: str) -> Callable[[EvaluationContext], str]:
    def run(_: EvaluationContext) -> str:
        raise AsError("P0108", reason)

    return run


def _space(item: Format) -> Callable[[EvaluationContext], str]:
    if item.code not in SPACES:
        return _refused(f"unknown format /{item.code}; use /D /E /F /G /H /I /C /S /X")
    space = SPACES[item.code] * (item.width or 0)
    return lambda _: space


def _written(read: Read, style: Format) -> Callable[[EvaluationContext], str]:
    write, width = WRITERS[style.code], style.width

    def run(context: EvaluationContext) -> str:
        value = read(context)
        if isinstance(value, str):
            return value
        if not isinstance(value, NUMBER):
            raise AsError("P0118", "a pose cannot be printed; DECOMPOSE it first")
        written = write(style, float(value))
        return written if width is None or len(written) <= width else "*" * width

    return run


def _default(_: Format, value: float) -> str:
    return f" {_short(value)}"


def _compact(_: Format, value: float) -> str:
    return _short(value)


def _short(value: float) -> str:
    return f"{value + 0.0:.{SIGNIFICANT}g}".upper()


def _scientific(style: Format, value: float) -> str:
    return f"{value:{style.width or 15}.{_decimals(style)}E}"


def _fixed(style: Format, value: float) -> str:
    return f"{value:{style.width or 15}.{_decimals(style)}f}"


def _general(style: Format, value: float) -> str:
    return f"{value:#{style.width or 15}.{_decimals(style) or 1}G}"


def _decimals(style: Format) -> int:
    return SIGNIFICANT if style.decimals is None else min(style.decimals, 99)


def _integer(style: Format, value: float) -> str:
    return str(int(rounded(value))).rjust(style.width or 0)


def _zero_filled(style: Format, value: float) -> str:
    return str(int(rounded(value))).zfill(style.width or 0)


def _hexadecimal(fill: str) -> Callable[[Format, float], str]:
    def write(style: Format, value: float) -> str:
        whole = int(rounded(value)) & 0xFFFFFFFF
        return f"{whole:X}".rjust(style.width or 0, fill)

    return write


WRITERS: dict[str, Callable[[Format, float], str]] = {
    "D": _default,
    "E": _scientific,
    "F": _fixed,
    "G": _general,
    "H": _hexadecimal(" "),
    "I": _integer,
    "J": _hexadecimal("0"),
    "K": _zero_filled,
    "L": _compact,
}

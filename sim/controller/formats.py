"""What $ENCODE, PRINT and TYPE make of their items (reference manual 5-111, 5-112, 9-70).

A format holds for the items behind it. /J /K /L are options of the controller and refused unless
`optional` is set. Choices where the manual is silent are listed in docs/as-emulator.md.
"""

from collections.abc import Callable, Iterable

from sim.controller.errors import AsError
from sim.controller.functions_number import rounded
from sim.controller.syntax_expressions import Format
from sim.controller.values import NUMBER, Value

DEFAULT = Format("D")
OPTIONAL = frozenset("JKL")
NUMERIC = frozenset("DEFGHIJKL")
SIGNIFICANT = 8
LINE_FEED = "\n"


def layout(items: Iterable[Value | Format], *, optional: bool) -> tuple[str, bool]:
    """Return the text of the items, and whether a line feed follows (not behind /S)."""
    current = DEFAULT
    parts: list[str] = []
    feed = True
    for item in items:
        if isinstance(item, str):
            parts.append(item)
        elif isinstance(item, NUMBER):
            parts.append(_number(current, float(item)))
        elif not isinstance(item, Format):
            raise AsError("P0118", "a pose cannot be printed; DECOMPOSE it first")
        elif item.code in NUMERIC:
            current = _allowed(item, optional=optional)
        elif item.code == "S":
            feed = False
        else:
            parts.append(_space(item))
    return "".join(parts), feed


def _allowed(item: Format, *, optional: bool) -> Format:
    if item.code in OPTIONAL and not optional:
        text = f"/{item.code} is an option of the controller that is not installed"
        raise AsError("P0108", f"{text}; pad by hand, or switch the emulator's option on")
    return item


def _space(item: Format) -> str:
    if item.code == "X":
        return " " * (item.width or 0)
    if item.code == "C":
        return LINE_FEED * (item.width or 0)
    raise AsError("P0108", f"/{item.code} is no format; there are /D /E /F /G /H /I /C /S /X")


def _number(style: Format, value: float) -> str:
    written = WRITERS[style.code](style, value)
    return written if style.width is None or len(written) <= style.width else "*" * style.width


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

"""Text formatting of $ENCODE, PRINT and TYPE (reference manual 5-111, 5-112, 9-70).

A format applies to the items after it. /J /K /L are options of the controller and rejected. Choices
where the manual is ambiguous are listed in docs/as-emulator.md.
"""

from collections.abc import Callable, Sequence

from sim.as_language.errors import AsError, refuse
from sim.as_language.functions import rounded
from sim.as_language.machine_api import EvaluationContext, Read, ReadOf
from sim.as_language.syntax import Format
from sim.as_language.values import NUMBER

DEFAULT = Format("D")
OPTIONAL = frozenset("JKL")
SIGNIFICANT = 8
SPACES = {"X": " ", "C": "\n"}


def layout(
    items: Sequence[Read | Format],
) -> ReadOf[tuple[str, bool]]:
    """Compile items to their text, and whether a line feed follows (not after /S)."""
    current = DEFAULT
    parts: list[ReadOf[str]] = []
    for item in items:
        if not isinstance(item, Format):
            parts.append(_written(item, current))
        elif item.code in OPTIONAL:
            text = f"/{item.code} is an option of the controller that is not installed"
            parts.append(refuse("P0108", f"{text}; pad by hand"))
        elif item.code in WRITERS:
            current = item
        elif item.code in SPACES:
            parts.append(_constant(SPACES[item.code] * (item.width or 0)))
        elif item.code != "S":
            text = f"unknown format /{item.code}; use /D /E /F /G /H /I /C /S /X"
            parts.append(refuse("P0108", text))
    feed = not any(isinstance(item, Format) and item.code == "S" for item in items)
    return lambda context: ("".join([part(context) for part in parts]), feed)


def _constant(text: str) -> ReadOf[str]:
    return lambda _: text


def _written(read: Read, style: Format) -> ReadOf[str]:
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


def _decimals(style: Format) -> int:
    return SIGNIFICANT if style.decimals is None else min(style.decimals, 99)


WRITERS: dict[str, Callable[[Format, float], str]] = {
    "D": lambda _, value: f" {value + 0.0:.{SIGNIFICANT}g}".upper(),
    "E": lambda style, value: f"{value:{style.width or 15}.{_decimals(style)}E}",
    "F": lambda style, value: f"{value:{style.width or 15}.{_decimals(style)}f}",
    "G": lambda style, value: f"{value:#{style.width or 15}.{_decimals(style) or 1}G}",
    "H": lambda style, value: f"{int(rounded(value)) & 0xFFFFFFFF:X}".rjust(style.width or 0),
    "I": lambda style, value: str(int(rounded(value))).rjust(style.width or 0),
}

"""Lint rules on the characters of a line."""

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence

from sim.as_language import keywords
from sim.as_language.findings import LintFinding
from sim.as_language.special_functions import ALL_NAMES
from sim.as_language.syntax import SIGNIFICANT_CHARACTERS, Position, SourceFile

LONGEST_LINE = 100
NAME = re.compile(r"\.?[$#@&]?[A-Za-z][A-Za-z0-9_.]*", re.ASCII)
NO_CODE = re.compile(r'"[^"]*"|\'.|;.*')


def line_traps(source: SourceFile, lines: Sequence[str]) -> Iterator[LintFinding]:
    """Yield warnings about the lines of the programs of a file."""
    spellings: dict[str, dict[str, Position]] = defaultdict(dict)
    for program in source.programs.values():
        for step in program.steps:
            line = lines[step.where.line - 1]
            code = NO_CODE.sub(" ", line)
            yield from _characters(step.where, line, code)
            for name in _long_names(code):
                spellings[name[: _significant(name)]].setdefault(name, step.where)
    for names in spellings.values():
        yield from _names(names)


def _characters(where: Position, line: str, code: str) -> Iterator[LintFinding]:
    if len(line) > LONGEST_LINE:
        text = f"{len(line)} columns; {LONGEST_LINE} are safe on every controller"
        yield LintFinding(where, "long-line", text)
    if not line.isascii():
        text = "a character that is not ASCII: on LOAD it may swallow the end of the line"
        yield LintFinding(where, "non-ascii", text)
    if "!=" in code:
        yield LintFinding(where, "not-equal", "!= is not in the manual; write <>")


def _long_names(code: str) -> Iterator[str]:
    for match in NAME.finditer(code):
        name = match[0].lower()
        if len(name) > _significant(name) and name.upper() not in keywords.KNOWN | ALL_NAMES:
            yield name


def _significant(name: str) -> int:
    """Return the number of significant characters, including a leading dot and sigil."""
    return SIGNIFICANT_CHARACTERS + len(name) - len(name.lstrip(".$#@&"))


def _names(names: dict[str, Position]) -> Iterator[LintFinding]:
    for name, where in names.items():
        short = name[: _significant(name)]
        yield LintFinding(where, "long-name", f"{name} is {short}: 15 characters are significant")
    first, *others = names
    for other in others:
        text = f"{other} and {first} are the same variable: their first 15 characters are equal"
        yield LintFinding(names[other], "same-name", text)

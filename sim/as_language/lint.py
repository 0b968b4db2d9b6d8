"""Static check of files (`--check`): the reports, and the rules on lines and names.

Rules on lines and names: characters, length, variables that are never defined.
"""

import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from sim.as_language import keywords, syntax
from sim.as_language.errors import SyntaxMistake
from sim.as_language.lint_rules import (
    LintFinding,
    at,
    nodes,
    passed_variable,
    step_traps,
    steps,
    task_traps,
)
from sim.as_language.memory import key_of
from sim.as_language.parser import examine, text_of
from sim.as_language.special_functions import ALL_NAMES
from sim.as_language.syntax import (
    SIGNIFICANT_CHARACTERS,
    Program,
    ProgramStep,
    SourceFile,
    SourcePosition,
    Variable,
)

VERDICTS = ("", "; strict: findings are errors", "; it does not parse")  # by exit code
SUFFIXES = (".as", ".pg")
LONGEST_LINE = 100
# Words at the end of a line that the manual has and public programs leave out.
CLOSING = {
    syntax.If: "THEN", syntax.While: "DO", syntax.CaseStatement: "OF", syntax.Value: ":",
}  # fmt: skip
# Codes of a program of which every line is AS, but a structure or the program is not closed.
NOT_CLOSED = keywords.words("P0140 P0141 P0142 P0143 P0144 P0145")
NAME = re.compile(r"\.?[$#@&]?[A-Za-z][A-Za-z0-9_.]*", re.ASCII)
WORDS = re.compile(r"[\w.]+|:", re.ASCII)
NO_CODE = re.compile(r'"[^"]*"|\'.|;.*')
RESERVED = keywords.KNOWN | keywords.OPERATORS | keywords.STATEMENTS.keys() | ALL_NAMES
# Instructions that write into their arguments.
WRITERS = keywords.words("""
    TCP_LISTEN TCP_ACCEPT TCP_CONNECT TCP_SEND TCP_RECV TCP_CLOSE TCP_END_LISTEN TCP_STATUS
    TCP_ISLINK UDP_SENDTO UDP_RECVFROM PROMPT UTIMER
    """)


class LintReport(NamedTuple):
    """Result of a check: parsed file, mistakes and findings."""

    source: SourceFile
    mistakes: tuple[SyntaxMistake, ...]
    findings: tuple[LintFinding, ...]

    @property
    def is_as(self) -> bool:
        """Whether the file holds a program or another section of AS."""
        source = self.source
        return bool(source.programs or source.data or source.skipped)

    @property
    def is_whole(self) -> bool:
        """Whether no program is cut off, and no structure lacks its other half."""
        codes = {mistake.code for mistake in self.mistakes}
        return not codes or not codes <= NOT_CLOSED

    @property
    def steps(self) -> int:
        """Number of steps of all programs."""
        return sum(len(program.steps) for program in self.source.programs.values())

    @property
    def not_executed(self) -> list[LintFinding]:
        """Findings of what the emulator parses but cannot execute."""
        return [finding for finding in self.findings if finding.kind == "not executed"]

    def exit_code(self, *, strict: bool) -> int:
        """Return 2 if the file does not parse, 1 for findings in strict mode, else 0."""
        if self.mistakes:
            return 2
        return 1 if strict and self.findings else 0


def check_text(text: str, name: str = "text") -> LintReport:
    """Parse the text of a file and collect all mistakes and findings."""
    source, mistakes = examine(text, name)
    lines = re.split(r"\r\n|\n|\r", text)
    found = [
        *(LintFinding(remark.where, "remark", remark.text) for remark in source.remarks),
        *line_traps(source, lines),
        *step_traps(source),
        *name_traps(source),
        *task_traps(source),
    ]
    order_of_file = attrgetter("where.line", "rule", "text")
    return LintReport(source, mistakes, tuple(sorted(set(found), key=order_of_file)))


def check_file(path: Path, *, strict: bool) -> int:
    """Print the report on a file; return the exit code."""
    report = check_text(text_of(path), str(path))
    source, code = report.source, report.exit_code(strict=strict)
    skipped = (f"{each.where}: skipped: section {each.name}" for each in source.skipped)
    summary = f"{source.name}: {_summary(report)}{VERDICTS[code]}"
    lines = (*report.mistakes, *report.findings, *skipped, summary)
    sys.stdout.writelines(f"{line}\n" for line in lines)
    return code


def check_folder(folder: Path, *, least_share: float) -> int:
    """Print what of the AS files in a folder and below it parses and is executed.

    Args:
        folder: With files *.as and *.pg.
        least_share: Share of the files that must parse.

    Returns:
        The exit code: 1 if fewer files parse, 2 if there are none. Files that are cut off, or have
        structures that do not close, are no measure of the parser: the controller refuses them too.
    """
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    reports = [check_text(text_of(path), str(path)) for path in paths if path.is_file()]
    if not reports:
        sys.stderr.write(f"{folder}: there is no file {' or '.join(SUFFIXES)} in it\n")
        return 2
    broken = [report for report in reports if report.mistakes]
    words = Counter(each.text for report in reports for each in report.not_executed)
    lines = [
        *(f"{each.mistakes[0]}; {len(each.mistakes)} in this file" for each in broken),
        *(f"{count:6} times not executed: {text}" for text, count in words.most_common()),
    ]
    whole = [report for report in reports if report.is_as and report.is_whole]
    others = sum(not report.is_as for report in reports)
    parsed = sum(not report.mistakes for report in whole)
    share, steps = parsed / max(len(whole), 1), sum(report.steps for report in reports)
    lines.append(
        f"{folder}: {parsed} of {len(whole)} whole AS files parse, {100.0 * share:.1f} %, at least "
        f"{100.0 * least_share:g} % shall; {len(reports) - others - len(whole)} more are not "
        f"closed, {others} without any program or section; {sum(words.values())} words in {steps} "
        "steps are not executed"
    )
    sys.stdout.writelines(f"{line}\n" for line in lines)
    return int(share < least_share)


def _summary(report: LintReport) -> str:
    source = report.source
    unsupported = len(report.not_executed)
    counts = {
        "programs": len(source.programs), "steps": report.steps, "data values": len(source.data),
        "skipped sections": len(source.skipped), "mistakes": len(report.mistakes),
        "not executed": unsupported, "warnings": len(report.findings) - unsupported,
    }  # fmt: skip
    return ", ".join(f"{count} {what}" for what, count in counts.items())


# --- names ----------------------------------------------------------------------------------------


@dataclass(slots=True)
class Uses:
    """Uses of a variable: first position, and kinds of use."""

    first: LintFinding  # without rule and text
    defined: bool = False
    scalar: bool = False
    array: bool = False
    kinds: set[str] = field(default_factory=set)


def name_traps(source: SourceFile) -> Iterator[LintFinding]:
    """Yield warnings about the variables of a file."""
    shared: dict[str, Uses] = {}
    for item in source.data:
        uses = Uses(LintFinding(item.where, "", ""), defined=True)
        shared.setdefault(key_of(item.variable), uses)
    for program in source.programs.values():
        own: dict[str, Uses] = {}
        for step in program.steps:
            _note(program, step, own, shared)
        for parameter in program.parameters:
            if key_of(parameter) in own:
                own[key_of(parameter)].defined = True
        yield from _judge(own, ".")
    yield from _judge(shared, "")


def _note(
    program: Program, step: ProgramStep, own: dict[str, Uses], shared: dict[str, Uses]
) -> None:
    written = dict(_written(step.statement))
    for node in nodes(step.statement):
        if not isinstance(node, Variable):
            continue
        uses = (own if node.local else shared).setdefault(
            key_of(node), Uses(at(program, step, "", ""))
        )
        kind = written.get(id(node))
        if kind is not None:
            uses.defined = True
            uses.kinds.add(kind)
        if kind != "passed":
            uses.array |= bool(node.indices) or node.whole
            uses.scalar |= not (node.indices or node.whole)


def _written(statement: syntax.Statement) -> Iterator[tuple[int, str]]:
    """Yield the identity of each variable that a statement defines, and its kind."""
    match statement:
        case syntax.Assign(target) | syntax.For(target):
            yield id(target), "real"
        case syntax.PointStatement(target) | syntax.Here(target):
            yield id(target), "location"
        case syntax.Decompose(target):
            yield id(target), "passed"
        case syntax.CallStatement(arguments=arguments):
            yield from ((id(passed_variable(item)), "passed") for item in arguments)
        case syntax.Scall(result=result):
            yield id(result), "real"
        case syntax.Instruction(name=name, arguments=arguments) if name in WRITERS:
            yield from ((id(item), "passed") for item in arguments)


def _judge(names: dict[str, Uses], dot: str) -> Iterator[LintFinding]:
    for key, uses in names.items():
        name, texts = f"{dot}{key}", {}
        if not uses.defined:
            texts["never-defined"] = "is never defined in this file"
        if uses.scalar and uses.array:
            texts["scalar-and-array"] = "is used with and without an index (P0132, P0133)"
        if {"real", "location"} <= uses.kinds:
            texts["two-types"] = "is a real here and a transformation there (P0150)"
        if not dot and key.upper() in RESERVED:
            texts["reserved"] = "is a reserved word of AS (P0117)"
        for rule, text in texts.items():
            yield uses.first._replace(rule=rule, text=f"{name} {text}")


# --- lines ----------------------------------------------------------------------------------------


def line_traps(source: SourceFile, lines: Sequence[str]) -> Iterator[LintFinding]:
    """Yield warnings about the lines of the programs of a file."""
    spellings: dict[str, dict[str, SourcePosition]] = defaultdict(dict)
    for _, step in steps(source):
        line = lines[step.where.line - 1]
        code = NO_CODE.sub(" ", line)
        yield from _characters(step.where, line, code)
        word = CLOSING.get(type(step.statement))
        if word is not None and word not in WORDS.findall(code.upper()):
            yield LintFinding(step.where, "left-out", f"{word} at the end; the manual has it")
        for name in _long_names(code):
            spellings[name[: _significant(name)]].setdefault(name, step.where)
    for names in spellings.values():
        yield from _names(names)


SWITCH_NAME = re.compile(r"\bSWITCH\s*\([^)]*\)", re.IGNORECASE)  # not of a variable: whole


def _characters(where: SourcePosition, line: str, code: str) -> Iterator[LintFinding]:
    if len(line) > LONGEST_LINE:
        text = f"{len(line)} columns; {LONGEST_LINE} are safe on every controller"
        yield LintFinding(where, "long-line", text)
    if not line.isascii():
        text = "a character that is not ASCII: on LOAD it may swallow the end of the line"
        yield LintFinding(where, "non-ascii", text)
    if "!=" in code:
        yield LintFinding(where, "not-equal", "!= is not in the manual; write <>")
    if "%" in code:
        yield LintFinding(where, "percent", "% is not in the manual; write MOD")


def _long_names(code: str) -> Iterator[str]:
    for match in NAME.finditer(SWITCH_NAME.sub(" ", code)):
        name = match[0].lower()
        is_word = name.upper() in keywords.KNOWN | ALL_NAMES or name in keywords.SWITCHES
        if len(name) > _significant(name) and not is_word:
            yield name


def _significant(name: str) -> int:
    """Return the number of significant characters, including a leading dot and sigil."""
    return SIGNIFICANT_CHARACTERS + len(name) - len(name.lstrip(".$#@&"))


def _names(names: dict[str, SourcePosition]) -> Iterator[LintFinding]:
    for name, where in names.items():
        short = name[: _significant(name)]
        yield LintFinding(where, "long-name", f"{name} is {short}: 15 characters are significant")
    first, *others = names
    for other in others:
        text = f"{other} and {first} are the same variable: their first 15 characters are equal"
        yield LintFinding(names[other], "same-name", text)

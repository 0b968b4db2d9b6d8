"""Static check of a file (`--check`): unsupported constructs and known traps."""

import re
import sys
from dataclasses import dataclass
from pathlib import Path

from forcemesh.errors import DataError
from sim.as_language.errors import SyntaxMistake
from sim.as_language.findings import LintFinding
from sim.as_language.lint_names import line_traps, name_traps
from sim.as_language.lint_steps import step_traps
from sim.as_language.lint_tasks import task_traps
from sim.as_language.parser import examine
from sim.as_language.syntax import SourceFile

VERDICTS = ("", "; strict: findings are errors", "; it does not parse")  # by exit code


@dataclass(frozen=True, slots=True)
class LintReport:
    """Result of a check: parsed file, mistakes and findings."""

    source: SourceFile
    mistakes: tuple[SyntaxMistake, ...]
    findings: tuple[LintFinding, ...]

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
    return LintReport(source, mistakes, tuple(sorted(set(found), key=_in_order_of_file)))


def check_file(path: Path, *, strict: bool) -> int:
    """Print the report on a file; return the exit code."""
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    report = check_text(text, str(path))
    _print(report, strict=strict)
    return report.exit_code(strict=strict)


def _print(report: LintReport, *, strict: bool) -> None:
    for line in (*report.mistakes, *report.findings):
        sys.stdout.write(f"{line}\n")
    source = report.source
    for section in source.skipped:
        sys.stdout.write(f"{section.where}: skipped: section {section.name}\n")
    verdict = VERDICTS[report.exit_code(strict=strict)]
    sys.stdout.write(f"{source.name}: {_summary(report)}{verdict}\n")


def _summary(report: LintReport) -> str:
    source = report.source
    steps = sum(len(program.steps) for program in source.programs.values())
    unsupported = sum(finding.kind == "not executed" for finding in report.findings)
    counts = {
        "programs": len(source.programs), "steps": steps, "data values": len(source.data),
        "skipped sections": len(source.skipped), "mistakes": len(report.mistakes),
        "not executed": unsupported, "warnings": len(report.findings) - unsupported,
    }  # fmt: skip
    return ", ".join(f"{count} {what}" for what, count in counts.items())


def _in_order_of_file(finding: LintFinding) -> tuple[int, str, str]:
    return finding.where.line, finding.rule, finding.text

"""Linker of program steps: resolves the jump targets of IF, WHILE, FOR, DO, CASE and GOTO."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from sim.as_language import syntax
from sim.as_language.errors import SyntaxMistake
from sim.as_language.syntax import ProgramStep, Statement

OPENS = {
    syntax.If: "IF", syntax.While: "WHILE", syntax.For: "FOR", syntax.CaseStatement: "CASE",
    syntax.Do: "DO",
}  # fmt: skip
CLOSED_BY = {"IF": "END", "WHILE": "END", "FOR": "END", "CASE": "END", "DO": "UNTIL"}


@dataclass(slots=True)
class Open:
    """Open structure: its step, and the inner steps that need the index of its end."""

    kind: str
    at: int
    inner: list[int] = field(default_factory=list)


class Linker:
    """Linker of one program; mistakes are collected, not raised."""

    def __init__(self, steps: list[ProgramStep], labels: dict[str, int]) -> None:
        """Start with the parsed steps, whose targets are unresolved."""
        self.statements: list[Statement] = [step.statement for step in steps]
        self.steps = steps
        self.labels = labels
        self.stack: list[Open] = []
        self.mistakes: list[SyntaxMistake] = []

    def link(self) -> tuple[ProgramStep, ...]:
        """Return the steps with resolved targets."""
        for at, statement in enumerate(self.statements):
            self._visit(at, statement)
        for left in self.stack:
            code = "P0144" if left.kind == "DO" else "P0140"
            self._add_error(left.at, code, f"{left.kind} has no {CLOSED_BY[left.kind]}")
        pairs = zip(self.steps, self.statements, strict=True)
        return tuple(replace(step, statement=statement) for step, statement in pairs)

    def _visit(self, at: int, statement: Statement) -> None:
        kind = OPENS.get(type(statement))
        match statement:
            case _ if kind is not None:
                self.stack.append(Open(kind, at))
            case syntax.Else():
                self._else(at)
            case syntax.Value() | syntax.Any():
                self._inside(at, "CASE", "P0145", "VALUE and ANY must be between CASE and END")
            case syntax.Until():
                self._until(at, statement)
            case syntax.End():
                self._end(at)
            case syntax.Goto():
                target = self.labels.get(statement.label, syntax.UNRESOLVED)
                self.statements[at] = replace(statement, target=target)
            case _:
                pass

    def _inside(self, at: int, kind: str, code: str, text: str) -> Open | None:
        if self.stack and self.stack[-1].kind == kind:
            self.stack[-1].inner.append(at)
            return self.stack[-1]
        self._add_error(at, code, text)
        return None

    def _else(self, at: int) -> None:
        opened = self._inside(at, "IF", "P0142", "ELSE must be between IF ... THEN and END")
        if opened is not None and len(opened.inner) > 1:
            self._add_error(at, "P0142", f"the IF of step {opened.at + 1} already has an ELSE")

    def _until(self, at: int, statement: syntax.Until) -> None:
        if self.stack and self.stack[-1].kind == "DO":
            self.statements[at] = replace(statement, false_at=self.stack.pop().at)
        else:
            self._add_error(at, "P0143", f"UNTIL closes DO{self._instead()}")

    def _end(self, at: int) -> None:
        if not self.stack or self.stack[-1].kind == "DO":
            self._add_error(at, "P0141", f"END closes IF, WHILE, FOR or CASE{self._instead()}")
            return
        opened = self.stack.pop()
        self.statements[at] = syntax.End(opened.kind, opened.at)
        for inner in opened.inner:
            branch = self.statements[inner]
            if isinstance(branch, syntax.Else | syntax.Value | syntax.Any):
                self.statements[inner] = replace(branch, end_at=at)
        head = self.statements[opened.at]
        match head:
            case syntax.If():
                false_at = opened.inner[0] + 1 if opened.inner else at
                self.statements[opened.at] = replace(head, false_at=false_at)
            case syntax.While() | syntax.For():
                self.statements[opened.at] = replace(head, false_at=at + 1)
            case syntax.CaseStatement():
                self.statements[opened.at] = self._case(head, opened.inner, at)
            case _:
                pass

    def _case(self, head: syntax.CaseStatement, inner: list[int], end: int) -> syntax.CaseStatement:
        branches = []
        default_at = end
        for at in inner:
            statement = self.statements[at]
            if isinstance(statement, syntax.Value):
                branches.append(syntax.Branch(statement.values, at + 1))
            else:
                default_at = at + 1
        return replace(head, branches=tuple(branches), default_at=default_at)

    def _instead(self) -> str:
        if not self.stack:
            return "; none is open here"
        last = self.stack[-1]
        return (
            f"; the {last.kind} of step {last.at + 1} is open and must first be closed by"
            f" {CLOSED_BY[last.kind]}"
        )

    def _add_error(self, at: int, code: str, text: str) -> None:
        self.mistakes.append(SyntaxMistake(self.steps[at].where, code, text))

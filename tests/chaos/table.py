"""Result tables of the trials, and the page that is made of them."""

from collections.abc import Iterable, Sequence
from datetime import datetime

from forcemesh.topics import ROLES
from tests.chaos.cases import KINDS, Case
from tests.chaos.outcome import LAST_ACCEPTED_S, Outcome, OutcomeLimits, Report, violations

HEAD = ("target", "kind", "trials", "held", "last motion accepted, ms", "at rest, ms",
        "stale executed", "moved after, mm", "cause reported", "violated bounds")  # fmt: skip
PAGE = "docs/chaos.md"
TITLES = {
    "sim": "The simulated robot (cells/demo.yaml)",
    "tcp": "Gateway and emulated controller over TCP (cells/demo-tcp.yaml)",
}


def page(report: Report, each: int, when: datetime) -> str:
    """Return the generated page for a run."""
    outcomes = report.outcomes
    broken = sum(bool(violations(each, report.limits[each.case.cell])) for each in outcomes)
    unheld = sum(outcome.continued for outcome in outcomes)
    held, bound_ms = len(outcomes) - unheld, LAST_ACCEPTED_S * 1e3
    lines = [
        "# Fault injection in real processes",
        "",
        "Made by `python -m tests.chaos --write`; method: [chaos](../tests/chaos/README.md).",
        f"{when:%Y-%m-%d}, two shared cores, at least {each} injections per service and kind:",
        f"{len(outcomes)} trials in real processes, each hit while the flange moved faster than",
        f"2 mm/s. {held} held, {unheld} continued, {broken} violated a bound.",
        f"{len(report.spoilt)} more were not valid and were repeated: the arm was too slow, or the",
        "machine itself stalled.",
        "",
        "For each kind the worst of two times in ms: from the fault to the last motion command",
        f"that the robot's process executed, bound {bound_ms:.0f} ms, and until the true flange is",
        "slower than 1 mm/s, counted from the thaw if the arm was frozen. `ended`: the process",
        "that executes commands, or the arm, ended with the fault.",
    ]
    for name, limits in report.limits.items():
        chosen = [outcome for outcome in outcomes if outcome.case.cell == name]
        bound = f"Bound for rest: {limits.still_s * 1e3:.0f} ms."
        lines += ["", f"## {TITLES[name]}", "", bound, "", *by_service(chosen, limits)]
    return "\n".join(lines) + "\n"


def rows(outcomes: Iterable[Outcome], limits: OutcomeLimits) -> list[str]:
    """Return a Markdown table: one row per service and kind, with the worst numbers."""
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in sorted(outcomes, key=lambda outcome: _place(outcome.case)):
        groups.setdefault((outcome.case.role, outcome.case.kind), []).append(outcome)
    found = [
        (role, kind, *_counts(group), *_worst(group), *_rest_of_row(group, limits))
        for (role, kind), group in groups.items()
    ]
    return _markdown(HEAD, found, ahead=2)


def by_service(outcomes: Iterable[Outcome], limits: OutcomeLimits) -> list[str]:
    """Return a Markdown table: one row per service, for each kind `last accepted/at rest` [ms]."""
    every = list(outcomes)
    kinds = [kind for kind in KINDS if any(outcome.case.kind == kind for outcome in every)]
    found = []
    for role in ROLES:
        group = [outcome for outcome in every if outcome.case.role == role]
        worst = [_worst([o for o in group if o.case.kind == kind]) for kind in kinds]
        times = ("/".join(each) for each in worst)
        if group:
            found.append((role, *_counts(group), *times, *_rest_of_row(group, limits)))
    return _markdown(("target", "trials", "held", *kinds, *HEAD[6:]), found, ahead=1)


def _markdown(head: Sequence[str], found: Sequence[Sequence[str]], *, ahead: int) -> list[str]:
    """Return the lines of a table whose first columns and the cause are text."""
    rule = f"|{'---|' * ahead}{'---:|' * (len(head) - ahead - 2)}---|---:|"
    return [f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(row)} |" for row in found)]


def _counts(group: Sequence[Outcome]) -> tuple[str, str]:
    return str(len(group)), str(sum(not outcome.continued for outcome in group))


def _rest_of_row(group: Sequence[Outcome], limits: OutcomeLimits) -> tuple[str, ...]:
    held = [outcome for outcome in group if not outcome.continued]
    causes = sorted({outcome.cause for outcome in held if outcome.cause})
    return (
        str(sum(outcome.stale for outcome in group)),
        f"{max((outcome.moved_m for outcome in held), default=0.0) * 1e3:.2f}",
        ", ".join(f"`{cause}`" for cause in causes) or "-",
        str(sum(bool(violations(outcome, limits)) for outcome in group)),
    )


def one_line(outcome: Outcome, limits: OutcomeLimits) -> str:
    """Return one trial as a line for the console."""
    case, broken = outcome.case, violations(outcome, limits)
    came_of_it = "went on" if outcome.continued else "held"
    rest = "gone" if outcome.arm_ended else _ms(outcome.still_s)
    return (
        f"{case.cell} {case.name:<32} {outcome.speed_m_s * 1e3:4.0f} mm/s  {came_of_it:<7} "
        f"last {_ms(outcome.last_accepted_s)} rest {rest} "
        f"stale {outcome.stale} oldest {_ms(outcome.oldest_accepted_s)} "
        f"moved {outcome.moved_m * 1e3:.2f} mm  {outcome.cause}"
        f"{'' if not broken else '  BROKEN: ' + '; '.join(broken)}"
    )


def _place(case: Case) -> tuple[int, int]:
    return ROLES.index(case.role), KINDS.index(case.kind)


def _worst(group: Sequence[Outcome]) -> tuple[str, str]:
    """Return the latest accepted motion and the latest rest of the trials that held [ms]."""
    held = [outcome for outcome in group if not outcome.continued]
    accepted = [o.last_accepted_s for o in held if o.last_accepted_s is not None]
    rests = [o.still_s for o in held if o.still_s is not None]
    last = _ms(max(accepted)) if accepted else "ended" if held else "-"
    has_arm_ended = any(outcome.arm_ended for outcome in held)
    return last, _ms(max(rests)) if rests else "ended" if has_arm_ended else "-"


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds * 1e3:.0f}"

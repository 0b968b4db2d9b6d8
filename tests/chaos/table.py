"""Result tables of the trials."""

from collections.abc import Iterable, Sequence
from itertools import groupby

from forcemesh.topics import ROLES
from tests.chaos.cases import KINDS, Case
from tests.chaos.outcome import Outcome, OutcomeLimits, violations

HEAD = (
    "| target | kind | trials | held | last motion accepted, ms | at rest, ms | stale executed |"
    " moved after, mm | cause reported | violated bounds |"
)
RULE = "|---|---|---:|---:|---:|---:|---:|---:|---|---:|"


def rows(outcomes: Iterable[Outcome], limits: OutcomeLimits) -> list[str]:
    """Return a Markdown table: one row per service and kind, with the worst numbers."""
    ordered = sorted(outcomes, key=lambda outcome: _place(outcome.case))
    lines = [HEAD, RULE]
    for _, group in groupby(ordered, key=lambda outcome: _place(outcome.case)):
        lines.append(_row(list(group), limits))
    return lines


def by_service(outcomes: Iterable[Outcome], limits: OutcomeLimits) -> list[str]:
    """Return a Markdown table: one row per service, for each kind `last accepted/at rest` [ms]."""
    every = list(outcomes)
    kinds = [kind for kind in KINDS if any(outcome.case.kind == kind for outcome in every)]
    head = ("target", "trials", "held", *kinds, "stale executed", "moved after, mm",
            "cause reported", "violated bounds")  # fmt: skip
    lines = [f"| {' | '.join(head)} |", f"|---|{'---:|' * (len(head) - 3)}---|---:|"]
    for role in ROLES:
        group = [outcome for outcome in every if outcome.case.role == role]
        if group:
            worst = [_worst([o for o in group if o.case.kind == kind]) for kind in kinds]
            causes = sorted({o.cause for o in group if o.cause and not o.continued})
            cells = (
                role,
                str(len(group)),
                str(sum(not outcome.continued for outcome in group)),
                *("/".join(times) for times in worst),
                str(sum(outcome.stale for outcome in group)),
                f"{max((o.moved_m for o in group if not o.continued), default=0.0) * 1e3:.2f}",
                ", ".join(f"`{cause}`" for cause in causes) or "-",
                str(sum(bool(violations(outcome, limits)) for outcome in group)),
            )
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def one_line(outcome: Outcome, limits: OutcomeLimits) -> str:
    """Return one trial as a line for the console."""
    case, broken = outcome.case, violations(outcome, limits)
    came_of_it = "went on" if outcome.continued else "held"
    return (
        f"{case.cell} {case.name:<32} {outcome.speed_m_s * 1e3:4.0f} mm/s  {came_of_it:<7} "
        f"last {_ms(outcome.last_accepted_s)} rest {_rest(outcome)} "
        f"stale {outcome.stale} oldest {_ms(outcome.oldest_accepted_s)} "
        f"moved {outcome.moved_m * 1e3:.2f} mm  {outcome.cause}"
        f"{'' if not broken else '  BROKEN: ' + '; '.join(broken)}"
    )


def _place(case: Case) -> tuple[int, int]:
    return ROLES.index(case.role), KINDS.index(case.kind)


def _row(group: list[Outcome], limits: OutcomeLimits) -> str:
    case = group[0].case
    held = [outcome for outcome in group if not outcome.continued]
    causes = sorted({outcome.cause for outcome in held if outcome.cause})
    cells = (
        case.role,
        case.kind,
        str(len(group)),
        str(len(held)),
        *_worst(group),
        str(sum(outcome.stale for outcome in group)),
        f"{max((o.moved_m for o in held), default=0.0) * 1e3:.2f}",
        ", ".join(f"`{cause}`" for cause in causes) or "-",
        str(sum(bool(violations(outcome, limits)) for outcome in group)),
    )
    return f"| {' | '.join(cells)} |"


def _worst(group: Sequence[Outcome]) -> tuple[str, str]:
    """Return the latest accepted motion and the latest rest of the trials that held [ms]."""
    held = [outcome for outcome in group if not outcome.continued]
    accepted = [o.last_accepted_s for o in held if o.last_accepted_s is not None]
    rests = [o.still_s for o in held if o.still_s is not None]
    last = _ms(max(accepted)) if accepted else "ended" if held else "-"
    has_arm_ended = any(outcome.arm_ended for outcome in held)
    return last, _ms(max(rests)) if rests else "ended" if has_arm_ended else "-"


def _rest(outcome: Outcome) -> str:
    return "gone" if outcome.arm_ended else _ms(outcome.still_s)


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds * 1e3:.0f}"

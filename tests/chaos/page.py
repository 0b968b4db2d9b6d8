"""Generator of docs/chaos.md."""

from datetime import datetime

from tests.chaos.outcome import LAST_ACCEPTED_S, violations
from tests.chaos.run import Report
from tests.chaos.table import by_service

PAGE = "docs/chaos.md"
TITLES = {
    "sim": "The simulated robot (cells/demo.yaml)",
    "tcp": "Gateway and emulated controller over TCP (cells/demo-tcp.yaml)",
}


def page(report: Report, each: int, when: datetime) -> str:
    """Return the page for a run."""
    outcomes = report.outcomes
    broken = sum(
        bool(violations(outcome, report.limits[outcome.case.cell])) for outcome in outcomes
    )
    unheld = sum(outcome.continued for outcome in outcomes)
    held, bound_ms = len(outcomes) - unheld, LAST_ACCEPTED_S * 1e3
    lines = [
        "# Fault injection in real processes",
        "",
        "Made by `python -m tests.chaos --write`; method: [chaos](../tests/chaos/README.md).",
        f"{when:%Y-%m-%d}, two shared cores, at least {each} injections per service and kind:",
        f"{len(outcomes)} trials in real processes, each hit while the flange moved faster than",
        f"2 mm/s. {held} held, {unheld} continued (a freeze of 0.1 s is as long as the deadlines",
        f"of these cells), {broken} violated a bound. {len(report.spoilt)} more were not valid and",
        "were repeated: the arm was too slow, or the machine itself stalled.",
        "",
        "For each kind the worst of two times in ms: from the fault to the last motion command",
        f"that the robot's process executed, bound {bound_ms:.0f} ms, and until the true flange is",
        "slower than 1 mm/s, counted from the thaw if the arm was frozen. `ended`: the process",
        "that executes commands, or the arm, ended with the fault.",
    ]
    for name, limits in report.limits.items():
        chosen = [outcome for outcome in outcomes if outcome.case.cell == name]
        title = f"## {TITLES[name]}"
        bound = f"Bound for rest: {limits.still_s * 1e3:.0f} ms."
        lines += ["", title, "", bound, "", *by_service(chosen, limits)]
    return "\n".join(lines) + "\n"

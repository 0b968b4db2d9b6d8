"""Output of an installation check: text for a terminal, or one JSON object."""

import json

import typer

from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.requests import AxesRequest
from identification.installation.terms import Installation

WRENCH_WITHIN_S, POLL_S = 2.0, 0.01
HEADLINES = {
    "right": "right: axes, signs and units are those of the cell file",
    "wrong": "wrong:",
    "cannot tell": "cannot tell:",
}


def print_installation(found: Installation, source: str, *, as_json: bool) -> None:
    """Print verdict, findings with remedies, what was not observed, and the measured numbers."""
    if as_json:
        typer.echo(json.dumps(as_tree(found, source), allow_nan=False))
        return
    typer.echo(f"{source}\n{HEADLINES[found.verdict]}")
    for finding in found.findings:
        typer.echo(f"  - {finding.text}\n    -> {finding.remedy}")
    for line in found.unidentified:
        typer.echo(f"  not observed: {line}")
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in found.evidence.items())
    if numbers:
        typer.echo(f"  ({numbers})")


def report_axes_to_cell(bus: Bus, found: Installation) -> None:
    """Report to the cell that its axes are right, which permits hand guiding."""
    if found.verdict != "right":
        return
    wrench = bus.reader(topics.WRENCH)
    give_up_ns = bus.clock.now_ns() + round(WRENCH_WITHIN_S * NS_PER_S)
    while (message := wrench.read(bus.clock.now_ns()).fresh) is None:
        if bus.clock.now_ns() > give_up_ns:
            typer.echo(
                "warning: no wrench is published: the cell did not receive the result", err=True
            )
            return
        bus.clock.sleep_s(POLL_S)
    reply = bus.ask(topics.AXES, AxesRequest(calibration=message.calibration))
    typer.echo(reply.text if reply.accepted else f"warning: {reply.text}", err=True)


def as_tree(found: Installation, source: str) -> dict[str, object]:
    """Return the result as a dict for JSON."""
    wiring = None if found.force_wiring is None else found.force_wiring.tolist()
    return {
        "verdict": found.verdict,
        "source": source,
        "findings": [
            {"code": each.code, "kind": each.kind, "text": each.text, "remedy": each.remedy}
            for each in found.findings
        ],
        "not_shown": list(found.unidentified),
        "force_channels_show": wiring,
        "evidence": found.evidence,
    }

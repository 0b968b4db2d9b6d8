"""Prints what was found of an installation: for a person, or as one JSON object."""

import json

import typer

from services.wrench.installation_terms import Installation

HEADLINES = {
    "right": "right: axes, signs and units are those of the cell file",
    "wrong": "wrong:",
    "cannot tell": "cannot tell:",
}


def tell(found: Installation, source: str, *, as_json: bool) -> None:
    """Print verdict, findings, what to write, what was not seen, and the numbers behind it."""
    if as_json:
        typer.echo(json.dumps(as_tree(found, source), allow_nan=False))
        return
    typer.echo(f"{source}\n{HEADLINES[found.verdict]}")
    for finding in found.findings:
        typer.echo(f"  - {finding.text}\n    -> {finding.mend}")
    for line in found.unseen:
        typer.echo(f"  not shown: {line}")
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in found.evidence.items())
    if numbers:
        typer.echo(f"  ({numbers})")


def as_tree(found: Installation, source: str) -> dict[str, object]:
    """Return the same as a program wants it."""
    wiring = None if found.force_wiring is None else found.force_wiring.tolist()
    return {
        "verdict": found.verdict,
        "source": source,
        "findings": [
            {"code": each.code, "kind": each.kind, "text": each.text, "mend": each.mend}
            for each in found.findings
        ],
        "not_shown": list(found.unseen),
        "force_channels_show": wiring,
        "evidence": found.evidence,
    }

"""Writes docs/faults.md from forcemesh/faults.py: `python -m tools.faults_page`."""

from pathlib import Path

from forcemesh.faults import FAULTS, FaultCode

PAGE = Path(__file__).resolve().parent.parent / "docs" / "faults.md"
HEAD = """# Faults

This page lists every reason for which the arm is stopped or a request refused, from `forcemesh/faults.py`; it is made
by `make readme`. The code and the rule number are published in `arbiter/status`, `robot/state` and every refusal,
together with the value that was found and the limit that it violated. `forcemesh status` shows them.

| kind | reaction of the arm | recovery |
|---|---|---|
| FAULT | it was braked and holds its position; latched | remedy the cause, `forcemesh clear`, `forcemesh arm` |
| HOLD | it was braked and holds its position; latched | `forcemesh arm`, once the cause is gone |
| REFUSAL | none: the request was not carried out | repeat the request after the remedy |

The controller's own fault numbers (103) are in [controller/README.md](../controller/README.md).

| rule | code | kind | cause | remedy |
|---:|---|---|---|---|
"""


def page() -> str:
    """Return the page."""
    return HEAD + "".join(_row(fault) for fault in FAULTS.values())


def _row(fault: FaultCode) -> str:
    return f"| {fault.rule} | `{fault.code}` | {fault.kind} | {fault.cause} | {fault.remedy} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

"""Writes docs/faults.md from forcemesh/faults.py: `python -m tools.faults_page`."""

from pathlib import Path

from forcemesh.faults import FAULTS, Fault

PAGE = Path(__file__).resolve().parent.parent / "docs" / "faults.md"
HEAD = """# Faults

Every reason why the arm was stopped or a request refused, from `forcemesh/faults.py`; this page is made by
`make readme`. A code and a rule number stand in `arbiter/status`, in `robot/state` and in every refusal,
together with what was found and the number that broke the rule. `forcemesh status` shows them.

| kind | what the arm did | what leads on |
|---|---|---|
| FAULT | it was braked and holds its position; latched | mend the cause, `forcemesh clear`, `forcemesh arm` |
| HOLD | it was braked and holds its position; latched | `forcemesh arm`, when the cause is gone |
| REFUSAL | nothing: what was asked for was not begun | ask again as the remedy says |

The controller's own fault numbers (103) are in [controller/README.md](../controller/README.md).

| rule | code | kind | cause | what to do |
|---:|---|---|---|---|
"""


def page() -> str:
    """Return the page."""
    return HEAD + "".join(_row(fault) for fault in FAULTS.values())


def _row(fault: Fault) -> str:
    return f"| {fault.rule} | `{fault.code}` | {fault.kind} | {fault.cause} | {fault.remedy} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

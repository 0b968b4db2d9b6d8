"""The page docs/installations.md: result of each line of defence for each installation error."""

from collections.abc import Iterable
from dataclasses import dataclass

MOST_N = 10.0

HEAD = """\
# Sensor installation errors and their detection

This page describes the check of the sensor installation, and shows which errors are detected where.

```
forcemesh check axes                     # the arm turns the tool through six poses
forcemesh check axes --from poses.csv    # the same from a recording (its columns: docs/payload.md)
forcemesh check axes --push              # a person pushes the tool by hand, as prompted
```

The command checks whether axes, signs and units of the sensor are those of the cell file, and
reports what is wrong and the correct entry. Exit code 0: correct; 1: wrong, or undecidable.
`--mass` gives the true mass below the sensor if the cell file does not contain it, `--json` is for
programs. The push test moves nothing and refuses an armed arm. Only the push test distinguishes a
sensor that reports the reaction force from an arm that hangs from the ceiling, and checks torques
that the tool's own moment does not show; those are reported as *not shown*.

## Method

Made by `python -m bench.installations --write` in virtual cells: the demo's arm, a tool of 1 kg, a
plate of 20 000 N/m, the sensor's usual noise. Three lines of defence, each tested as if the
previous ones had been skipped:

1. **`forcemesh check axes`**: the arm holds the tool in six attitudes. Result: what is wrong, and
   the correct entry. `forcemesh calibrate` refuses with the same message.
2. **Arming**: tare, rotate the wrist by 70 degrees by hand, `arm` for force. *tare* and *arming*
   give the reason of the refusal.
3. **The press**: the error is hidden at rest, as if it had been removed by a tare; the tool presses
   on the plate with 8 N. *press* gives the stop and its time, *peak* the largest true force on the
   plate, *travel* the motion of the tool after the first contact.

A wiring is written as the true axes that the three channels show. Errors of the forces only give
the same arming and press results as those of all six channels, and errors of the torques only do
not affect a press in mode position: these are not repeated.
"""

SHORT = (
    "error",
    "detected by the check",
    "tare or arming refused",
    "press below 10 N",
    "none of these",
)
COLUMNS = ("wiring, or error", "result of the check", "tare", "arming", "press", "peak", "travel")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of each line of defence; empty: not detected. Peak of the true force."""

    mistake: str
    group: str
    verdict: str
    findings: tuple[str, ...]
    tare: str
    arming: str
    press: str
    peak_N: float
    travel_m: float

    @property
    def sentences(self) -> str:
        """Every finding with its remedy."""
        return ". ".join(self.findings)

    @property
    def is_detected(self) -> bool:
        """Whether the check detects the error."""
        return self.verdict == "wrong"

    @property
    def is_refused(self) -> bool:
        """Whether arming for force with a rotated wrist, or the tare, is refused."""
        return bool(self.arming or self.tare)

    @property
    def is_harmless(self) -> bool:
        """Whether the press itself stayed below 10 N."""
        return self.peak_N < MOST_N


def short(answer: str) -> str:
    """Return the first reason of an answer, without advice."""
    words = answer.split(": ")
    return answer if len(words) < 3 else ": ".join(words[1:2])


def page(found: list[Outcome]) -> str:
    """Return the whole page."""
    wrong = [each for each in found if not each.mistake.startswith("none")]
    groups = {each.group: [w for w in wrong if w.group == each.group] for each in found}
    lines = [HEAD, "## Summary", "", *_table(SHORT, map(_summary, groups.values()))]
    for group in groups:
        played = [each for each in found if each.group == group]
        kept = [n for n, name in enumerate(COLUMNS) if _is_played(name, played)]
        rows = [[_cells(each)[n] for n in kept] for each in played]
        lines += ["", f"## {group[0].upper()}{group[1:]}", ""]
        lines += _table([COLUMNS[n] for n in kept], rows)
    return "\n".join(lines) + "\n"


def _is_played(column: str, found: list[Outcome]) -> bool:
    if column in {"press", "peak", "travel"}:
        return any(each.peak_N for each in found)
    if column in {"tare", "arming"}:
        return any(each.is_refused for each in found)
    return True


def _summary(found: list[Outcome]) -> list[str]:
    def count(good: Iterable[bool]) -> str:
        return f"{sum(good)} of {len(found)}"

    armed, pressed = _is_played("arming", found), _is_played("press", found)
    through = [
        each
        for each in found
        if not (each.is_detected or each.is_refused or (pressed and each.is_harmless))
    ]
    return [
        found[0].group,
        count(each.is_detected for each in found),
        count(each.is_refused for each in found) if armed else "not played",
        count(each.is_harmless for each in found) if pressed else "not played",
        str(len(through)),
    ]


def _cells(found: Outcome) -> list[str]:
    return [
        found.mistake,
        found.sentences or found.verdict,
        short(found.tare) or "-",
        short(found.arming) or "-",
        found.press or "-",
        f"{found.peak_N:.1f} N" if found.peak_N else "-",
        f"{1e3 * found.travel_m:.2f} mm" if found.travel_m else "-",
    ]


def _table(names: Iterable[str], rows: Iterable[list[str]]) -> list[str]:
    head = list(names)
    body = (f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in rows)
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *body]

"""The page docs/installations.md: what each line of defence says of each wrong installation."""

from collections.abc import Iterable
from dataclasses import dataclass

MOST_N = 10.0

HEAD = """\
# Wrong installations of the sensor, and who notices

```
forcemesh check axes                     # the arm turns the tool through six poses
forcemesh check axes --from poses.csv    # the same from a recording (its columns: docs/payload.md)
forcemesh check axes --push              # a person pushes the tool by hand, as prompted
```

says whether axes, signs and units of the sensor are those of the cell file, what looks wrong, and
what to write instead. Exit code 0: right; 1: wrong, or it cannot tell. `--mass` gives the true mass
below the sensor where the cell file does not know it, `--json` is for programs. The push test moves
nothing and refuses an armed arm. It alone tells a sensor that reports the reaction from an arm that
hangs, and torques that the tool's own moment does not show; those are named as *not shown*.

## How this was tried

Made by `python -m bench.installations --write` in virtual cells: the demo's arm, a tool of 1 kg, a
plate of 20 000 N/m, the sensor's usual noise. Three lines of defence, each played as if those
before it had been passed by:

1. **`forcemesh check axes`**: the arm shows its tool's weight to the sensor in six attitudes. What
   looks wrong, and what to write instead. `forcemesh calibrate` refuses with the same sentence.
2. **Arming**: tare, turn the wrist by 70 degrees by hand, `arm` for force. *tare* and *arming* say
   why they were refused.
3. **The press**: what the sensor shows wrong is hidden at rest, as if it had been tared away; the
   tool presses on the plate with 8 N. *press* says what stopped it and when, *peak* how hard the
   plate was truly pressed, *way* how far the tool went after the first touch.

A wiring is written as the true axes that the three channels show. Forces alone are armed and press
as all six channels do, torques alone press as they should in mode position: not played again.
"""

SHORT = (
    "wrong",
    "told by the check",
    "not tared or not armed",
    "press below 10 N",
    "none of these",
)
COLUMNS = ("wiring, or what is wrong", "the check says", "tare", "arming", "press", "peak", "way")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What each line of defence said; empty: it let it pass. Peak of the true force."""

    mistake: str
    group: str
    verdict: str
    findings: tuple[str, ...]
    tare: str
    arming: str
    press: str
    peak_N: float
    way_m: float

    @property
    def sentences(self) -> str:
        """Every finding with its mend."""
        return ". ".join(self.findings)

    @property
    def is_told(self) -> bool:
        """Whether the check says that it is wrong."""
        return self.verdict == "wrong"

    @property
    def is_refused(self) -> bool:
        """Whether it cannot be armed for force once the wrist has been turned, or not tared."""
        return bool(self.arming or self.tare)

    @property
    def is_harmless(self) -> bool:
        """Whether the press itself stayed below 10 N."""
        return self.peak_N < MOST_N


def short(answer: str) -> str:
    """Return the first reason of an answer, without advice."""
    words = answer.split(": ")
    return answer if len(words) < 3 else ": ".join(words[1:2])


def page(seen: list[Outcome]) -> str:
    """Return the whole page."""
    wrong = [each for each in seen if not each.mistake.startswith("none")]
    groups = {each.group: [w for w in wrong if w.group == each.group] for each in seen}
    lines = [HEAD, "## In short", "", *_table(SHORT, map(_summary, groups.values()))]
    for group in groups:
        played = [each for each in seen if each.group == group]
        kept = [n for n, name in enumerate(COLUMNS) if _is_played(name, played)]
        rows = [[_cells(each)[n] for n in kept] for each in played]
        lines += ["", f"## {group[0].upper()}{group[1:]}", ""]
        lines += _table([COLUMNS[n] for n in kept], rows)
    return "\n".join(lines) + "\n"


def _is_played(column: str, seen: list[Outcome]) -> bool:
    if column in {"press", "peak", "way"}:
        return any(each.peak_N for each in seen)
    if column in {"tare", "arming"}:
        return any(each.is_refused for each in seen)
    return True


def _summary(seen: list[Outcome]) -> list[str]:
    def count(good: Iterable[bool]) -> str:
        return f"{sum(good)} of {len(seen)}"

    armed, pressed = _is_played("arming", seen), _is_played("press", seen)
    through = [
        each
        for each in seen
        if not (each.is_told or each.is_refused or (pressed and each.is_harmless))
    ]
    return [
        seen[0].group,
        count(each.is_told for each in seen),
        count(each.is_refused for each in seen) if armed else "not played",
        count(each.is_harmless for each in seen) if pressed else "not played",
        str(len(through)),
    ]


def _cells(seen: Outcome) -> list[str]:
    return [
        seen.mistake,
        seen.sentences or seen.verdict,
        short(seen.tare) or "-",
        short(seen.arming) or "-",
        seen.press or "-",
        f"{seen.peak_N:.1f} N" if seen.peak_N else "-",
        f"{1e3 * seen.way_m:.2f} mm" if seen.way_m else "-",
    ]


def _table(names: Iterable[str], rows: Iterable[list[str]]) -> list[str]:
    head = list(names)
    body = (f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in rows)
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *body]

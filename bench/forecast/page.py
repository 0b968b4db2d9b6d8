"""What forecasts contain, as Markdown for docs/forecast.md."""

import re
from collections import Counter
from collections.abc import Sequence
from statistics import median

from bench.forecast.fit import SHARE
from bench.forecast.measure import (
    MAP_JOBS,
    QUANTITIES,
    Compared,
    Drawn,
    contained_share,
    interval_of,
)

HEAD = """# Forecasts

A forecast states before arming what force control will do: when the force settles after the first
touch, how high it peaks, and the largest error while the tool is fed across a slope. It is
computed from the cell file and a measured map, without a hub and without motion:

    forcemesh forecast 15 --cell cells/demo.yaml
    forcemesh forecast 15 --stiffness 50000 --law adaptive --speed 30

`arm` warns when the forecast for the cell's own contact and law breaks a limit; it never refuses
for that reason. The panel shows the forecast of the set point, law and loop host that are entered.
`forcemesh report` prints the forecast of each press of a recording beside what was measured.

Each value is an interval, at most twice as high as low. The map is fitted to {map_jobs} jobs of
each law on the simulated RS007L (MuJoCo, 1 ms) with the real law, wrench filter and motion limits
(`bench/forecast`); the width is that within which {share:.0%} of the jobs were that a fit had not
seen, in ten-fold cross-validation, at most twice in all. Outside of the measured range, for host
controller, hand guiding and tasks per axis there is no forecast, and the text says which value is
outside. Measured on a surface with sensor noise of 0.1 N, without the packet of a controller:
its rounding and segments are not in the map.

## Drawn jobs

Stiffness 2e3 to 1e5 N/m, up to four times softer than the cell file states; delay 0 to 60 ms
(plain law: to 120 ms); loop 30 to 250 Hz; set point 5 to 40 N; feed 5 to 50 mm/s across a slope of
10 degrees; acceleration limit 1 to 10 m/s2; speed limit 20 to 150 mm/s; tool 0.4 to 2.5 kg; plain
and adaptive law in turn.
The seed was fixed before the first run. None of them is in the map. A job that does not settle
counts as not contained. Made by `{command}`.
"""
NUMBER = re.compile(r"\d[\d.]*(?:e[+-]\d+)?")
NAMES = {
    "settling_s": "settling after touch",
    "peak_N": "peak of the press",
    "follow_error_N": "largest error on the slope",
}


def page(rows: Sequence[Compared], draw: Drawn, command: str) -> str:
    """Return the whole page."""
    parts = [
        HEAD.format(map_jobs=MAP_JOBS, share=SHARE, command=command),
        shares(rows),
        "## Draws without a forecast\n",
        _refused(draw),
        "## Jobs that were not contained\n",
        _missed(rows),
    ]
    return "\n".join(parts)


def shares(rows: Sequence[Compared]) -> str:
    """Return the table of contained shares and widths."""
    body = []
    for law in ("all", *dict.fromkeys(row.job.law for row in rows)):
        these = [row for row in rows if law in ("all", row.job.law)]
        for quantity in QUANTITIES:
            widths = [_width(row, quantity) for row in these]
            body.append(
                (
                    law,
                    NAMES[quantity],
                    f"{len(these)}",
                    f"{contained_share(these, quantity):.1%}",
                    f"{median(widths):.2f}",
                    f"{max(widths):.2f}",
                )
            )
        body.append(
            (law, "**each of them**", f"{len(these)}", f"{contained_share(these):.1%}", "", "")
        )
    return _table(("law", "quantity", "jobs", "contained", "high / low, median", "largest"), body)


def _width(row: Compared, quantity: str) -> float:
    interval = interval_of(row.forecast, quantity)
    return interval.high / interval.low


def _refused(draw: Drawn) -> str:
    total = len(draw.refused) + len(draw.jobs)
    kinds = Counter(NUMBER.sub("x", text).split(":")[0] for text in draw.refused)
    lines = [f"{len(draw.refused)} of {total} draws were outside of the map:\n"]
    lines += [f"- {count}: {kind}" for kind, count in kinds.most_common()]
    return "\n".join(lines) + "\n"


def _missed(rows: Sequence[Compared]) -> str:
    body = []
    for row in rows:
        for quantity in QUANTITIES:
            if row.contains(quantity):
                continue
            interval, value = interval_of(row.forecast, quantity), getattr(row.happened, quantity)
            job = row.job
            body.append(
                (
                    job.law,
                    f"{job.stiffness_N_m:.3g} N/m, {job.delay_ms} ms, {1e3 / job.period_ms:.0f} Hz",
                    f"{job.setpoint_N:.1f} N, {1e3 * job.feed_m_s:.0f} mm/s",
                    NAMES[quantity],
                    f"{interval.low:.3g} to {interval.high:.3g}",
                    f"{value:.3g}",
                )
            )
    return _table(("law", "contact and loop", "job", "quantity", "forecast", "happened"), body)


def _table(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in body]
    return "\n".join(lines) + "\n"

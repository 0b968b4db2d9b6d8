"""The rows of the tasks per axis as Markdown, for docs/force-axes.md."""

from collections.abc import Iterable
from math import inf

from bench.force.axis_scenes import LAWS, LOOPS_HZ, SCENES, STIFFNESSES_N_M
from bench.force.page import table
from bench.force.run import Row

PROMISES = (  # scene, measure, quantity, limit
    ("three axes", "steady_error_N", "three axes, steady error, N", 0.1),
    ("three axes", "held_deg", "three axes, rotation that is held, degrees", 0.2),
    ("change of task", "bump_N", "change of frame at the present loads, N", 1.0),
    ("change of task", "steady_error_N", "changed axes, steady error, N", 0.1),
    ("change of task", "held_mm", "changed axes, motion that is held, mm", 0.2),
)
WORDS = {
    "settling_s": "settles within 1 N, s",
    "overshoot_N": "overshoot, N",
    "steady_error_N": "steady error, N",
    "held_deg": "held rotation, degrees",
    "held_mm": "held axis, mm",
    "bump_N": "bump, N",
}

HEAD = """# Tasks per axis: benchmark

Force set points along several axes while the tool is held in a bushing whose stiffness is diagonal
in none of the frames: its principal values are 1, 0.7 and 0.5 of the one stated, along drawn axes,
and its centre is not the TCP. Each figure is the worst of three bushings. The rig is that of
[force.md](force.md), with 10 ms of delay. Three axes: `x=force:5 y=force:-4 z=force:10` in base at
once, from no load. Change of task: first `z=force:10` in base, then all three axes of a turned
frame at the loads of that moment (the bump is the largest change of force), then
`x=held y=force:-5 z=force:12` in that frame. Rotation is held. Overshoot and settling: in means of
8 ms; settling includes the ramp of the set points. Steady error: mean of its size over the last
second, of the worst axis. Made by `{command}`.

## Requirements and results

Adaptive law, 250 Hz, 5e3 to 1e5 N/m.
"""
RATES = """## By rate of the loop

The adaptive law, without any knowledge of the contact.
"""
PEERS = """## Comparison with other control laws

Loop of 250 Hz. The other laws are given the gain rule 0.45 / (k tau), with the true delay and the
true stiffness of the stiffest direction; the adaptive law is given neither that stiffness nor those
axes. The laws of the regulator begin without contact: in three axes, most of their time at 5e3 N/m
is the approach, at a speed that the stiffest configured contact bears; the peers have no approach
and move by gain and error from the start. Along a held axis the peers do not move. Admittance and
FDCC-like are our own minimal implementations after the documentation of their packages. The plain
law has the cell's deadband of 0.3 N, the adaptive one a quarter of it in contact, the peers none.
"""


def axes_page(rows: list[Row], command: str) -> str:
    """Return the whole page."""
    ours = [row for row in rows if row["law"] == "adaptive"]
    fast = [row for row in rows if row["loop_hz"] == LOOPS_HZ[0]]
    promised = [row for row in ours if row["loop_hz"] == LOOPS_HZ[0]]
    body = []
    for scene, measure, quantity, limit in PROMISES:
        value = _worst(_of(promised, scene=scene), measure)
        met = "yes" if value <= limit else "**no**"
        body.append((quantity, f"{limit:g}", f"{value:.2g}", met))
    parts = [
        HEAD.format(command=command),
        table(("quantity", "limit", "worst result", "met"), body),
    ]
    parts += [RATES, *_by_rate(ours), PEERS, *_by_law(fast)]
    return "\n".join(parts)


def _by_rate(rows: list[Row]) -> Iterable[str]:
    for scene in SCENES:
        body = [
            (f"{hz:g} Hz, {k:g} N/m", *_cells(_of(rows, scene=scene, loop_hz=hz, stiffness_N_m=k)))
            for hz in LOOPS_HZ
            for k in STIFFNESSES_N_M
        ]
        yield table((scene, *_titles(rows, scene)), body)


def _by_law(rows: list[Row]) -> Iterable[str]:
    for scene in SCENES:
        body = [
            (f"{law}, {k:g} N/m", *_cells(_of(rows, scene=scene, law=law, stiffness_N_m=k)))
            for law in LAWS
            for k in STIFFNESSES_N_M
        ]
        yield table((scene, *_titles(rows, scene)), body)


def _of(rows: list[Row], **values: str | float) -> list[Row]:
    """Return the rows with these values, one for each bushing."""
    return [row for row in rows if all(row[name] == value for name, value in values.items())]


def _measures(rows: list[Row]) -> list[str]:
    return [name for name in WORDS if rows and name in rows[0]]


def _titles(rows: list[Row], scene: str) -> list[str]:
    return [WORDS[name] for name in _measures(_of(rows, scene=scene))]


def _cells(rows: list[Row]) -> Iterable[str]:
    for name in _measures(rows):
        value = _worst(rows, name)
        yield "does not" if value == inf else f"{value:.2g}"


def _worst(rows: list[Row], name: str) -> float:
    return max((inf if row[name] is None else float(row[name]) for row in rows), default=inf)

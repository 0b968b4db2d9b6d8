"""The rows of the path scenes as Markdown, for docs/force-path.md."""

from collections.abc import Iterable
from math import inf

from bench.force.page import table
from bench.force.paths import LAWS, LOOPS_HZ, PROMISED, SPEEDS_M_S, STIFFNESSES_N_M
from bench.force.run import Row
from bench.force.stage import HOLD_N

MEAN_N, WORST_SHARE = 0.3, 2.0  # promised at PROMISED

HEAD = """# Path with force: benchmark

10 N along a path of poses on a plane tilted by 8 degrees, a cylinder and a hemisphere of 80 mm
radius (`forcemesh follow PATH.csv --poses tcp`): 40 mm out and back, the tool turned along the
normal. The program is off by 1 mm along each axis and by 2 degrees; the tool begins upright, so on
the tilted plane it turns by 8 degrees in contact first. The rig is that of [force.md](force.md):
MuJoCo, delay 10 ms, friction 0.3. Mean error and deviation: after the first second; on stiff
contacts the first turn takes longer, and counts. Worst press: the highest force, in means of 8 ms,
relative to the set point. Made by `{command}`.

## Requirements and results
"""
MAP = """What a slower link promises is read from this table: the worst of the three surfaces, mean
error in N / worst press relative to the set point. The adaptive law, without any knowledge of the
contact. A dash: it did not come to the end of its path.
"""
PEERS = """Loop of 250 Hz, worst of the three surfaces. The other laws are given the gain rule
0.45 / (k tau) with the true stiffness and delay of each scene; admittance and FDCC-like are our own
minimal implementations after the documentation of their packages, on the same path.
"""


def paths_page(rows: list[Row], command: str) -> str:
    """Return the whole page."""
    found = _at(rows, "adaptive", PROMISED)
    body = [
        ("mean error, N", MEAN_N, _worst(found, "mean_error_N")),
        ("worst press / set point", WORST_SHARE, _worst(found, "worst_press_share")),
    ]
    met = [(name, f"{limit:g}", f"{value:.3g}", _met(value, limit)) for name, limit, value in body]
    speed, k, hz = PROMISED
    where = (
        f"Adaptive law, {hz:g} Hz, {1e3 * speed:g} mm/s, {k:g} N/m, {HOLD_N:g} N, each surface.\n"
    )
    return "\n".join(
        [
            HEAD.format(command=command),
            where,
            table(("quantity", "limit", "worst result", "met"), met),
            "## By rate of the loop and speed\n",
            MAP,
            _map(rows),
            "## Comparison with other control laws\n",
            PEERS,
            *_comparisons(rows),
        ]
    )


def _met(value: float, limit: float) -> str:
    return "yes" if value <= limit else "**no**"


def _worst(rows: Iterable[Row], name: str) -> float:
    return max((inf if row[name] is None else float(row[name]) for row in rows), default=inf)


def _map(rows: list[Row]) -> str:
    body = []
    for hz in LOOPS_HZ:
        for speed in SPEEDS_M_S:
            cells = []
            for k in STIFFNESSES_N_M:
                here = _at(rows, "adaptive", (speed, k, hz))
                mean, share = (_cell(here, name) for name in ("mean_error_N", "worst_press_share"))
                cells.append(f"{mean} / {share}")
            body.append((f"{hz:g} Hz", f"{1e3 * speed:g} mm/s", *cells))
    return table(("loop", "speed", *(f"{k:g} N/m" for k in STIFFNESSES_N_M)), body)


def _comparisons(rows: list[Row]) -> Iterable[str]:
    for name, title in (
        ("mean_error_N", "mean error, N"),
        ("worst_press_share", "worst press / set point"),
        ("missed_mm", "path missed, mm"),
        ("aside_mm", "deviation across the path, mm"),
    ):
        body = [
            (
                f"{1e3 * speed:g} mm/s, {k:g} N/m",
                *(_cell(_at(rows, law, (speed, k, LOOPS_HZ[0])), name) for law in LAWS),
            )
            for speed in SPEEDS_M_S
            for k in STIFFNESSES_N_M
        ]
        yield table((title, *LAWS), body)


def _at(rows: list[Row], law: str, place: tuple[float, float, float]) -> list[Row]:
    """Return the rows of a law at a speed, stiffness and loop rate, one for each surface."""
    names = ("speed_m_s", "stiffness_N_m", "loop_hz")
    return [r for r in rows if r["law"] == law and tuple(r[name] for name in names) == place]


def _cell(rows: list[Row], name: str) -> str:
    value = _worst(rows, name)
    return "-" if value == inf else f"{value:.2f}"

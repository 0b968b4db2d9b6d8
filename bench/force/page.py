"""The rows of the benchmark as Markdown, for docs/force.md."""

from collections.abc import Iterable, Sequence
from itertools import groupby

from bench.force.promises import Rows, requirements, with_own_results
from bench.force.run import Row
from bench.force.tcp_releases import LAWS

HEAD = """# Force control benchmark

This page states the requirements on the force control laws and the results of their benchmark. It
is measured on the simulated RS007L (MuJoCo, 1 ms) with the real wrench filter, motion limits and
regulator in one loop on a virtual clock; sensor noise 0.1 N at 1 kHz, median of five, low-pass
5 ms, control at 250 Hz unless stated otherwise, 150 mm/s and 10 m/s2 at most. One set of settings
for all: the stiffest contact is configured as 2e5 N/m, from which the adaptive law starts. tau is
the true sum of delay, servo lag, filters, half a period and the processes. Settled means within
1 N, in means of 8 ms, after the first 15 ms; overshoot is true lift-off times stiffness, in percent
of the 30 N. Surfaces move under a tool at rest, equivalent to a sliding tool. Made by `{command}`.

![Release from 30 N](pictures/force-releases.png)

## Requirements and results

The speed ratio to a peer law is given as its reciprocal, so smaller is better in every row.
"""

IDENTIFIED = """First contact (the law starts from 2e5 N/m) / with the stiffness identified, and the
estimate of the effective stiffness then: it includes the servos in series, about 8e5 N/m.
"""
SLOW = """The robot accepts one pose per iteration of the loop.
"""
OVER_TCP = """## Over TCP, contact unknown

The emulated controller executes the shipped program (cells/demo-tcp.yaml; delay 66 ms at its step
of 0.125 ms). Every cell is configured for 1e5 N/m; the contact is softer or the same. Loop: its
iterations per second, by its own counter. Host controller: the PC sends wrenches, and with the
adaptive law also gains as the stiffness estimate improves; there is no prediction. The contact
known in advance: [over-tcp.md](over-tcp.md). A set point is rounded to 0.01 mm.
"""
LIMITED = """At 10 ms of delay, with a lower speed limit. At 1e3 N/m the speed limit bounds the
first part of the travel and the inertia limit the rest, so the times of both add up.
"""
LOW_ACCELERATION = """\
The same releases with a lower acceleration limit: settling in tau, first contact /
with the stiffness identified, and overshoot. Braking takes longer, without more overshoot.
"""
PEERS = """Every law is tuned by the same search (bench/force/search.py): 10 gains times 3 second
parameters, each on every scene; more than 5 % overshoot does not count as settled. One setting:
the one that settles in most scenes, and is fastest in them. Tuned here: the best for this scene
alone, with known stiffness and delay. Admittance and FDCC-like are our own minimal
implementations after the documentation of the packages.
"""


def page(rows: Rows, command: str) -> str:
    """Return the whole page."""
    parts = [
        HEAD.format(command=command),
        _promises(rows),
        "## Release from 30 N: settling in tau, overshoot\n",
        IDENTIFIED,
        *_releases(rows["release"]),
        "## Slow loops\n",
        SLOW,
        slow_table(rows["slow loops"]),
        OVER_TCP,
        tcp_table(rows["over TCP"]),
        LIMITED,
        limited_table(rows["limited speed"]),
        "## Arms with low braking acceleration\n",
        LOW_ACCELERATION,
        _brakes(rows["slow brakes"]),
        "## Comparison with other control laws\n",
        PEERS,
        *_peers(with_own_results(rows)),
        _fixed(rows["fixed gain"][0]),
        "## Scenes\n",
        "![10 N on waves](pictures/force-following.png)\n",
        *_scenes(rows["scenes"]),
    ]
    return "\n".join(parts) + "\n"


def _promises(rows: Rows) -> str:
    body = [
        (p.text, f"{p.limit:.3g}", f"{p.found:.3g}", p.where, "yes" if p.kept else "**no**")
        for p in requirements(rows)
    ]
    return table(("quantity", "limit", "worst result", "where", "met"), body)


def _releases(rows: list[Row]) -> Iterable[str]:
    for error, same in groupby(rows, key=lambda row: float(row["delay_error_ms"])):
        these = list(same)
        stiffnesses = sorted({row["stiffness_N_m"] for row in these})
        title = "delay known" if error == 0.0 else f"delay assumed {error:+g} ms wrong"
        body = []
        for delay, line in groupby(these, key=lambda row: int(row["delay_ms"])):
            cells = [f"{_release(r)}, {r['stiffness_ratio']:.2f} k" for r in line]
            body.append((f"{delay} ms", *cells))
        yield table((title, *(f"{k:g}" for k in stiffnesses)), body)


def slow_table(rows: list[Row]) -> str:
    """Return the releases with a robot of low pose rate."""
    body = [
        (
            f"{r['loop_hz']:g} Hz, {r['delay_ms']} ms",
            f"{r['stiffness_N_m']:g}",
            _s(r["first_s"]),
            _s(r["identified_s"]),
            f"{max(r['first_overshoot_pct'], r['identified_overshoot_pct']):.1f} %",
        )
        for r in rows
    ]
    return table(("loop, delay", "stiffness", "first", "identified", "overshoot"), body)


def tcp_table(rows: list[Row]) -> str:
    """Return the releases over TCP with each law, some of them stopped."""
    body = [
        (
            f"{r['host']}, {1e3 * r['as_step_s']:g} ms",
            f"{r['stiffness_N_m']:g}",
            *(cell for law in LAWS for cell in _over_tcp(r, law)),
        )
        for r in rows
    ]
    measures = [f"{law}: {what}" for law in LAWS for what in ("first", "overshoot", "loop")]
    return table(("host, AS step", "stiffness", *measures), body)


def _over_tcp(row: Row, law: str) -> tuple[str, str, str]:
    if f"{law}_stopped" in row:
        return str(row[f"{law}_stopped"]), "", ""
    loop_hz = row[f"{law}_loop_hz"]
    loop = "unknown" if loop_hz is None else f"{loop_hz:.0f} /s"
    return _s(row[f"{law}_first_s"]), f"{row[f'{law}_overshoot_pct']:.1f} %", loop


def limited_table(rows: list[Row]) -> str:
    """Return the releases with a lower speed limit."""
    body = [
        (
            f"{r['speed_m_s'] * 1e3:g} mm/s",
            f"{r['stiffness_N_m']:g}",
            _s(r["first_s"]),
            _s(r["identified_s"]),
            f"{max(r['first_overshoot_pct'], r['identified_overshoot_pct']):.1f} %",
        )
        for r in rows
    ]
    return table(("speed limit", "stiffness", "first", "identified", "overshoot"), body)


def _brakes(rows: list[Row]) -> str:
    stiffnesses = sorted({row["stiffness_N_m"] for row in rows})
    body = [
        (f"{accel:g} m/s2, {delay} ms", *(_release(row) for row in line))
        for (accel, delay), line in groupby(rows, key=lambda r: (r["accel_m_s2"], r["delay_ms"]))
    ]
    return table(("at most", *(f"{k:g}" for k in stiffnesses)), body)


def _release(row: Row) -> str:
    overshoot_pct = max(row["first_overshoot_pct"], row["identified_overshoot_pct"])
    return f"{_tau(row, 'first')} / {_tau(row, 'identified')}, {overshoot_pct:.0f} %"


def _peers(rows: list[Row]) -> Iterable[str]:
    for law, same in groupby(rows, key=lambda row: str(row["law"])):
        these = list(same)
        body = [
            (
                _where(r),
                *(_s(r[name]) for name in ("one_s", "tuned_here_s", "first_s", "identified_s")),
                _lead(r["one_s"], r["first_s"]),
                _lead(r["tuned_here_s"], r["identified_s"]),
            )
            for r in these
        ]
        one = these[0]["one_setting"]
        chosen = f"{one['gain_m_per_Ns']:.2g} m/(N s), {one['time_s'] * 1e3:g} ms"
        head = (f"{law} ({chosen})", "one setting", "tuned here", "ours, first", "ours, identified")
        yield table((*head, "ratio, one setting", "ratio, tuned here"), body)


def _fixed(row: Row) -> str:
    return (
        f"A PI with the gain rule for 1e5 N/m takes {_s(row['fixed_s'])} on 5e3 N/m at 10 ms, "
        f"ours {_s(row['identified_s'])} with the stiffness identified.\n"
    )


def _scenes(rows: list[Row]) -> Iterable[str]:
    for scene in dict.fromkeys(str(row["scene"]) for row in rows):
        these = [row for row in rows if row["scene"] == scene]
        named = ("scene", "law", "stiffness_N_m", "delay_ms", "speed_m_s")
        measures = [name for name in these[0] if name not in named]
        body = [(_who(r), _where(r), *(_number(r[m]) for m in measures)) for r in these]
        yield f"### {scene.capitalize()}\n"
        yield table(("law", "where", *(_words(m) for m in measures)), body)


def _where(row: Row) -> str:
    return f"{row['stiffness_N_m']:g}, {row['delay_ms']} ms"


def _who(row: Row) -> str:
    speed = "" if row["speed_m_s"] == 0.15 else f", {row['speed_m_s'] * 1e3:g} mm/s"
    return f"{row['law']}{speed}"


def _words(name: str) -> str:
    return name.replace("_", " ")


def _number(value: float | None) -> str:
    return "not settled" if value is None else f"{value:.3g}"


def _s(seconds: float | None) -> str:
    return "not settled" if seconds is None else f"{seconds:.3g} s"


def _tau(row: Row, name: str) -> str:
    seconds = row[f"{name}_s"]
    return "-" if seconds is None else f"{seconds / row['tau_s']:.1f}"


def _lead(theirs: float | None, ours: float) -> str:
    return "-" if theirs is None else f"{theirs / ours:.2g}"


def table(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in body]
    return "\n".join(lines) + "\n"

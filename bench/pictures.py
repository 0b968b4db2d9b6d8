"""Pictures of docs/, drawn from the stored results."""

from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from bench.pages import heading
from bench.results import ROOT, Result, Row

mpl.use("Agg")

PICTURES = ROOT / "docs" / "pictures"
Panes = Sequence[Axes]


def draw(result: Result, folder: Path = PICTURES) -> None:
    """Draw the picture of a result, if it has one."""
    if result.name not in DRAWN:
        return
    count, fill = DRAWN[result.name]
    figure, panes = plt.subplots(1, count, figsize=(11, 3.6), layout="constrained", squeeze=False)
    fill({name: each.records for name, each in result.tables.items()}, panes[0])
    figure.savefig(folder / f"{result.name}.png", dpi=110)
    plt.close(figure)


def lines(pane: Axes, rows: Sequence[Row], x: str, y: str, *, by: str) -> None:
    """Draw the worst value over x, a line for each group; a missing value ends its line."""
    for group in sorted({row[by] for row in rows}):
        ours = [row for row in rows if row[by] == group]
        places = sorted({row[x] for row in ours})
        values = [[row[y] for row in ours if row[x] == place] for place in places]
        worst = [np.nan if None in each else max(each) for each in values]
        pane.plot(places, worst, marker="o", label=str(group))
    pane.set(xlabel=heading(x), ylabel=heading(y))
    pane.grid(alpha=0.3)
    pane.legend(title=heading(by), fontsize=8)


def heat(pane: Axes, rows: Sequence[Row], x: str, y: str, *, value: str) -> None:
    """Draw a value over x and y with its number; white where there is none."""
    xs, ys = (sorted({row[name] for row in rows}) for name in (x, y))
    grid = np.full((len(ys), len(xs)), np.nan)
    for row in rows:
        if row[value] is not None:
            grid[ys.index(row[y]), xs.index(row[x])] = row[value]
    pane.imshow(np.log10(grid), vmin=0.4, vmax=2.0, cmap="RdYlGn_r", aspect="auto")
    for i, j in np.ndindex(grid.shape):
        text = f"{grid[i, j]:.1f}" if np.isfinite(grid[i, j]) else "lifts off or\noscillates"
        pane.text(j, i, text, ha="center", va="center", fontsize=7)
    pane.set(xlabel=heading(x), ylabel=heading(y))
    pane.set_xticks(range(len(xs)), [f"{each:g}" for each in xs], fontsize=8)
    pane.set_yticks(range(len(ys)), [f"{each:g}" for each in ys])


def _chain(rows: dict[str, list[Row]], panes: Panes) -> None:
    names = [row["chain"] for row in rows["chains"]]
    for place, name in enumerate(("p50_us", "p99_us", "max_us")):
        at = np.arange(len(names)) + 0.27 * (place - 1)
        times_ms = [row[name] / 1e3 for row in rows["chains"]]
        panes[0].barh(at, times_ms, height=0.25, label=name.removesuffix("_us"))
    panes[0].set(xlabel="time from source to sink [ms]")
    panes[0].legend(fontsize=8)
    panes[1].barh(range(len(names)), [row["processor_core_pct"] for row in rows["chains"]])
    panes[1].set(xlabel="processor [% of a core]")
    for pane in panes:
        pane.set_yticks(range(len(names)), names, fontsize=8)
        pane.invert_yaxis()


def _force(rows: dict[str, list[Row]], panes: Panes) -> None:
    known = [row for row in rows["release"] if row["delay_error_ms"] == 0]
    titles = ("adaptive, first contact, one setting", "plain PI tuned for 2e4 N/m at 10 ms")
    for pane, found, title in zip(panes, (known, rows["one-gain"]), titles, strict=True):
        heat(pane, found, "stiffness_N_m", "delay_ms", value="first_tau")
        pane.set(title=f"{title}: settling in tau")


def _force_path(rows: dict[str, list[Row]], panes: Panes) -> None:
    fast = [row for row in rows["rows"] if row["loop_hz"] == 250]
    for pane, k in zip(panes, (5e3, 2e4, 1e5), strict=True):
        ours = [row for row in fast if row["stiffness_N_m"] == k]
        lines(pane, ours, "speed_mm_s", "mean_error_N", by="law")
        pane.set(title=f"{k:g} N/m, 250 Hz", ylim=(0.0, None))


def _force_axes(rows: dict[str, list[Row]], panes: Panes) -> None:
    for pane, name in zip(panes, ("three-axes", "change-of-task"), strict=True):
        fast = [row for row in rows[name] if row["loop_hz"] == 250]
        lines(pane, fast, "stiffness_N_m", "settling_s", by="law")
        pane.set(title=f"{name.replace('-', ' ')}, 250 Hz", xscale="log", ylim=(0.0, None))


def _over_tcp(rows: dict[str, list[Row]], panes: Panes) -> None:
    for pane, controller in zip(panes, ("default", "pessimistic"), strict=True):
        ours = [row for row in rows["rows"] if row["controller"] == controller]
        lines(pane, ours, "stiffness_N_m", "settling_tau", by="least_segment_ms")
        pane.set(title=f"{controller} controller: longest of all rows", xscale="log", yscale="log")


def _installations(rows: dict[str, list[Row]], panes: Panes) -> None:
    for group in dict.fromkeys(row["group"] for row in rows["rows"]):
        peaks = sorted(r["peak_N"] for r in rows["rows"] if r["group"] == group and r["peak_N"])
        if peaks:
            panes[0].plot(np.arange(len(peaks)) / len(peaks), peaks, ".-", label=group)
    panes[0].axhline(10.0, color="black", linewidth=0.8)
    panes[0].set(xlabel="share of the errors that were pressed", ylabel="true peak force [N]",
                 yscale="log", title="press with 8 N, the error hidden at rest")  # fmt: skip
    panes[0].legend(fontsize=8)
    panes[0].grid(alpha=0.3)


def _forecast(rows: dict[str, list[Row]], panes: Panes) -> None:
    names = [f"{row['law']}: {row['quantity']}" for row in rows["shares"]]
    panes[0].barh(range(len(names)), [row["contained_pct"] for row in rows["shares"]])
    panes[0].axvline(90.0, color="black", linewidth=0.8)
    panes[0].set(xlabel="forecasts that contained what happened [%]", xlim=(80.0, 100.0))
    panes[0].set_yticks(range(len(names)), names, fontsize=8)
    panes[0].invert_yaxis()


Fill = Callable[[dict[str, list[Row]], Panes], None]
DRAWN: dict[str, tuple[int, Fill]] = {
    "chain": (2, _chain),
    "force": (2, _force),
    "force-path": (3, _force_path),
    "force-axes": (2, _force_axes),
    "over-tcp": (2, _over_tcp),
    "installations": (1, _installations),
    "forecast": (1, _forecast),
}

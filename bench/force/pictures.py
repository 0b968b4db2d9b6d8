"""Figures of the benchmark: releases, paths, surface following, map of settling times."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from bench.force import scenes, stage
from bench.force.paths import LAWS as PATH_LAWS
from bench.force.paths import PROMISED, PathScene, played
from bench.force.rig import ForceRig, SceneSettings
from bench.force.run import LAWS, Row
from bench.force.settle import PRESS_N

mpl.use("Agg")


def releases(path: Path) -> None:
    """Draw the release from 30 N on three stiffnesses, by three laws."""
    figure, panes = plt.subplots(1, 3, figsize=(11, 3.4), sharey=True, layout="constrained")
    for pane, k in zip(panes, (5e3, 2e4, 1e5), strict=True):
        for name, make in LAWS.items():
            rig = ForceRig(SceneSettings(k, 10).cell())
            rig.press(PRESS_N)
            pilot = make(rig)
            pilot.setpoint_N = 0.0
            trace = rig.run(pilot, 0.6)
            pane.plot(trace.t_s, trace.push_N, label=name)
        pane.axhspan(-1.0, 1.0, color="tab:green", alpha=0.2)
        pane.set(title=f"{k:g} N/m", xlabel="time [s]")
        pane.grid(alpha=0.3)
    panes[0].set_ylabel("force [N]")
    panes[-1].legend(fontsize=8)
    figure.suptitle("release from 30 N, delay 10 ms, one setting for all")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def map_of(rows: list[Row], fixed: dict[tuple[float, int], float], path: Path) -> None:
    """Draw settling in tau over stiffness and delay: ours, and a PI law tuned for one case."""
    right = [row for row in rows if row["delay_error_ms"] == 0.0]
    ks = sorted({row["stiffness_N_m"] for row in right})
    ds = sorted({row["delay_ms"] for row in right})
    ours = {
        (row["stiffness_N_m"], row["delay_ms"]): (row["first_s"] or np.nan) / row["tau_s"]
        for row in right
    }
    figure, panes = plt.subplots(1, 2, figsize=(11, 3.2), layout="constrained")
    titles = ("adaptive, first contact, one setting", "plain PI tuned for 2e4 N/m at 10 ms")
    for pane, values, title in zip(panes, (ours, fixed), titles, strict=True):
        grid = np.array([[values.get((k, d), np.nan) for k in ks] for d in ds])
        pane.imshow(np.log10(grid), vmin=0.4, vmax=2.0, cmap="RdYlGn_r", aspect="auto")
        for i, j in np.ndindex(grid.shape):
            text = f"{grid[i, j]:.1f}" if np.isfinite(grid[i, j]) else "lifts off or\noscillates"
            pane.text(j, i, text, ha="center", va="center", fontsize=8)
        pane.set(title=f"{title}: settling in tau", xlabel="stiffness [N/m]")
        pane.set_ylabel("delay [ms]")
        pane.set_xticks(range(len(ks)), [f"{k:g}" for k in ks])
        pane.set_yticks(range(len(ds)), [str(d) for d in ds])
    figure.savefig(path, dpi=110)
    plt.close(figure)


def paths(path: Path) -> None:
    """Draw the force along a path over a hemisphere, by each law."""
    speed_m_s, k_N_m, loop_hz = PROMISED
    figure, pane = plt.subplots(figsize=(9, 3.4), layout="constrained")
    for law in PATH_LAWS:
        scene = PathScene(law, "hemisphere", speed_m_s, SceneSettings(k_N_m, 10, loop_hz))
        _, _, trace = played(scene)
        pane.plot(trace.t_s, trace.push_N, label=law)
    pane.axhline(stage.HOLD_N, color="black", linewidth=0.8)
    place = f"{1e3 * speed_m_s:g} mm/s over a hemisphere of {k_N_m:g} N/m and back"
    pane.set(title=f"10 N at {place}, program off by 1 mm and 2 degrees")
    pane.set(xlabel="time [s]", ylabel="force [N]")
    pane.grid(alpha=0.3)
    pane.legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def following(path: Path) -> None:
    """Draw the force on a wavy surface under two laws."""
    figure, pane = plt.subplots(figsize=(9, 3.4), layout="constrained")
    for name in ("adaptive", "plain, known k"):
        trace = scenes.followed(SceneSettings(2e4, 30), LAWS[name], "sine")
        pane.plot(trace.t_s, trace.push_N, label=name)
    pane.axhline(stage.HOLD_N, color="black", linewidth=0.8)
    pane.set(title="10 N on waves of 2 mm / 100 mm at 20 mm/s, 2e4 N/m, delay 30 ms")
    pane.set(xlabel="time [s]", ylabel="force [N]")
    pane.grid(alpha=0.3)
    pane.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)

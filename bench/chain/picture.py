"""The picture of the comparison: times from sensor to robot, and processor time by process."""

from pathlib import Path
from statistics import median

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from bench.chain.compare import Comparison
from bench.chain.load import Load
from bench.chain.page import CHAINS

mpl.use("Agg")

PCT_PER_LETTER = 1.4  # of a name within a bar, at this size


def draw(found: Comparison, path: Path) -> None:
    """Draw the share of samples that took longer than a time, and bars of processor time."""
    figure, (times, load) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    curves = {"cell": np.concatenate([run.chain_us for run in found.cells])}
    for kind, name in CHAINS.items():
        curves[name] = np.concatenate([us for us, _ in found.bares[kind]])
    for name, us in curves.items():
        ordered = np.sort(us)
        times.loglog(ordered / 1e3, 1.0 - np.arange(len(ordered)) / len(ordered), label=name)
    times.set(xlabel="time from source to sink [ms]", ylabel="share of samples that took longer")
    times.grid(alpha=0.3)
    times.legend(fontsize=8)
    bars: dict[str, list[dict[str, Load]]] = {"cell": [run.load for run in found.cells]}
    bars |= {CHAINS[kind]: [load for _, load in runs] for kind, runs in found.bares.items()}
    for place, runs in enumerate(bars.values()):
        left = 0.0
        for role in runs[0]:
            share = median(run[role].cpu_pct for run in runs)
            load.barh(place, share, left=left, edgecolor="white")
            if share > PCT_PER_LETTER * len(role):
                load.text(left + share / 2, place, role, ha="center", va="center", fontsize=7)
            left += share
    load.set_yticks(range(len(bars)), list(bars), fontsize=8)
    load.invert_yaxis()
    load.set(xlabel="processor time [% of a core]")
    figure.savefig(path, dpi=110)
    plt.close(figure)

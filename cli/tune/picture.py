"""Figure of a tuning: measurements, Bode plot, and simulated release."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cli.tune.measure import Readings
from forcemesh.errors import DataError
from tuning.advice import Advice, RatedGain
from tuning.margins import frequencies, release_response, response
from tuning.servo import SIGMAS

NOW, ADVISED, MODEL = "tab:orange", "tab:blue", "0.4"
SHOWN_TAUS = 25.0


def save(path: Path, readings: Readings, advices: list[Advice], title: str) -> None:
    """Write the figure. Raises DataError when that is not possible."""
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    figure.suptitle(title)
    cells = figure.subplots(2, 2)
    _plot_steps(cells[0, 0], readings)
    _plot_press(cells[0, 1], readings)
    _plot_bode(cells[1, 0], advices)
    _plot_releases(cells[1, 1], advices)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: the picture cannot be written: {error}") from error


def _plot_steps(axes: Axes, readings: Readings) -> None:
    servo, steps = readings.arm, readings.steps[0]
    start_s, place_m = steps.commanded_s[0], steps.commanded_m[0]
    axes.step(
        steps.commanded_s - start_s,
        1e3 * (steps.commanded_m - place_m),
        where="post",
        label="commanded",
    )
    axes.plot(steps.measured_s - start_s, 1e3 * (steps.measured_m - place_m), label="measured")
    axes.set(xlabel="time [s]", ylabel="position [mm]", title="Steps in free space")
    uncertainty_ms = 1e3 * SIGMAS * servo.deviation_s
    text = f"delay and lag {1e3 * servo.sum_s:.1f} +/- {uncertainty_ms:.1f} ms"
    axes.text(0.98, 0.05, text, transform=axes.transAxes, ha="right")
    axes.legend(loc="upper right")


def _plot_press(axes: Axes, readings: Readings) -> None:
    axes.set(xlabel="penetration [mm]", ylabel="press force [N]", title="Press")
    found = readings.spring
    if found is None:
        axes.text(0.5, 0.5, "not measured", transform=axes.transAxes, ha="center")
        return
    travel, forces = np.array(readings.travel_m), np.array(readings.forces_N)
    line_N = np.array([forces.min(), forces.max()])
    line_m = travel.mean() + (line_N - forces.mean()) / found.k_N_m
    axes.plot(1e3 * (line_m - travel.min()), line_N, color=MODEL)
    axes.plot(1e3 * (travel - travel.min()), forces, "o", color=ADVISED)
    text = f"{found.k_N_m:.0f} +/- {SIGMAS * found.spread_N_m:.0f} N/m"
    axes.text(0.98, 0.05, text, transform=axes.transAxes, ha="right")


def _plot_bode(axes: Axes, advices: list[Advice]) -> None:
    phases = axes.twinx()
    for advice, style in zip(advices, ("-", ":"), strict=False):
        w = frequencies(advice.force.loop)
        for rated, colour, label in _present_and_recommended(advice):
            L = response(rated.loop, w)
            axes.loglog(w, np.abs(L), style, color=colour, label=f"{label}, {advice.host}")
        phase = np.degrees(np.unwrap(np.angle(response(advice.force.loop, w))))
        shown = phase > -360.0
        phases.semilogx(w[shown], phase[shown], style, color=MODEL, linewidth=0.8)
    tau_s = advices[0].tau_s
    axes.axhline(1.0, color=MODEL, linewidth=0.6)
    phases.axhline(-180.0, color=MODEL, linewidth=0.6, linestyle="--")
    axes.set(xlim=(0.05 / tau_s, 20.0 / tau_s), ylim=(0.02, 20.0), xlabel="frequency [rad/s]")
    axes.set(ylabel="|L| (coloured)", title="Force loop: gain and phase")
    phases.set(ylim=(-360.0, 0.0), ylabel="phase [degrees] (grey)")
    axes.legend(loc="lower left")


def _plot_releases(axes: Axes, advices: list[Advice]) -> None:
    for advice, style in zip(advices, ("-", ":"), strict=False):
        for rated, colour, label in _present_and_recommended(advice):
            t, force = release_response(rated.loop, SHOWN_TAUS)
            axes.plot(t, force, style, color=colour, label=f"{label}, {advice.host}")
    axes.axhline(0.0, color=MODEL, linewidth=0.6)
    axes.set(ylim=(-0.6, 1.1), xlabel="time [s]", ylabel="share of the force")
    axes.set(title="Release, simulated")
    axes.legend(loc="upper right")


def _present_and_recommended(advice: Advice) -> tuple[tuple[RatedGain, str, str], ...]:
    return ((advice.force_now, NOW, "now"), (advice.force, ADVISED, "recommended"))

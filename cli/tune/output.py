"""Output of a tuning: lines of text, a figure, and a file that a cell file may include."""

from pathlib import Path

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cli.calibration.output_files import back_up
from cli.tune.measure import Readings
from common.config.cell import CellConfig
from common.config.state_file import replace_file
from forcemesh.errors import DataError
from tuning.advice import Advice, MeasuredCell, RatedGain, refusal_reason, remarks
from tuning.margins import frequencies, release_response, response
from tuning.servo import SIGMAS, Servo

HEAD = """\
# Measured by `forcemesh tune`: these values override those of a cell file that has the key
# `tuning: <this file>`. The stiffness is that of the surface pressed on: increase it when the tool
# may touch a stiffer one.
"""
NOW, ADVISED, MODEL = "tab:orange", "tab:blue", "0.4"
SHOWN_TAUS = 25.0


def report_lines(
    cell: CellConfig,
    measured: MeasuredCell,
    advices: list[Advice],
    sections: dict[str, dict[str, float]],
) -> list[str]:
    """Return the lines of the report."""
    lines = [_delay_text(cell, measured.servo), _lag_text(cell, measured.servo)]
    spring, file_value = measured.spring, f"(cell file: {cell.contact.stiffness_N_m:.0f})"
    if spring is None:
        lines.append(f"stiffness not measured {file_value}: gains are for the cell file's value")
    else:
        uncertainty_N_m = SIGMAS * spring.spread_N_m
        lines.append(f"stiffness {spring.k_N_m:.0f} +/- {uncertainty_N_m:.0f} N/m {file_value}")
        lines.append("tilt stiffness not measured: cell file's value, scaled like the stiffness")
    if measured.controller is not None:
        tau_ms = 1e3 * measured.controller.tau_s
        uncertainty_ms = 1e3 * SIGMAS * measured.controller.deviation_s
        lines.append(f"delay of the controller's own loop {tau_ms:.0f} +/- {uncertainty_ms:.0f} ms")
    refusal = refusal_reason(cell, measured, advices)
    for advice in advices:
        lines.append(f"loop host {advice.host}: tau at most {1e3 * advice.tau_s:.1f} ms")
        force, torque = (None, None) if refusal else (advice.force, advice.torque)
        lines += _rows("position", "m/(N s)", advice.force_now, force)
        lines += _rows("orientation", "rad/(N m s)", advice.torque_now, torque)
    if refusal:
        return [*lines, f"nothing is recommended: {refusal}"]
    lines += remarks(cell, measured, sections)
    lines.append("for the cell file:")
    return lines + [f"  {line}" for line in _yaml(sections).splitlines()]


def _delay_text(cell: CellConfig, servo: Servo) -> str:
    found = f"{1e3 * servo.sum_s:.1f} +/- {1e3 * SIGMAS * servo.deviation_s:.1f} ms"
    file_ms = 1e3 * cell.plant.servo_s
    return (
        f"delay and lag together {found}, from the command to the measured pose (cell file: "
        f"{file_ms:.1f} ms)"
    )


def _lag_text(cell: CellConfig, servo: Servo) -> str:
    least_ms, most_ms = (1e3 * lag_s for lag_s in servo.lags_s)
    file_value = f"(cell file: {1e3 * cell.robot.lag_s:.1f} ms)"
    if servo.is_split:
        return f"lag: {least_ms:.1f} to {most_ms:.1f} ms {file_value}"
    return f"delay and lag cannot be separated: lag {least_ms:.1f} to {most_ms:.1f} ms {file_value}"


def _rows(label: str, unit: str, now: RatedGain, then: RatedGain | None) -> list[str]:
    rows = [("now", now)] if then is None else [("now", now), ("recommended", then)]
    return [
        f"  {label:<12} {name:<12} {rated.gain:9.3g} {unit}: {_verdict(rated)}"
        for name, rated in rows
    ]


def _verdict(rated: RatedGain) -> str:
    found, forecast = rated.margins, rated.forecast
    if not found.stable:
        return "NOT STABLE"
    if found.crossover_rad_s == 0.0:
        return "no effect"
    settling = "not settling"
    if forecast.settling_s is not None:
        settling = f"settles in {forecast.settling_s:.2f} s"
    return (
        f"{settling}, overshoot {forecast.overshoot_pct:.0f} %; margins: phase "
        f"{found.phase_deg:.0f} degrees, gain x {found.gain_margin:.1f}, delay "
        f"{1e3 * found.delay_s:.0f} ms"
    )


def save_sections(path: Path, sections: dict[str, dict[str, float]]) -> None:
    """Write the file; a previous one is kept as `.before`. Raises DataError."""
    back_up(path)
    replace_file(path, HEAD + _yaml(sections))


def _yaml(sections: dict[str, dict[str, float]]) -> str:
    return str(yaml.safe_dump(sections, sort_keys=False))


def save_figure(path: Path, readings: "Readings", advices: list[Advice], title: str) -> None:
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


def _plot_steps(axes: "Axes", readings: "Readings") -> None:
    servo, steps = readings.arm, readings.steps[0]
    start_s, place_m = steps.commanded_s[0], steps.commanded_m[0]
    commanded_mm = 1e3 * (steps.commanded_m - place_m)
    axes.step(steps.commanded_s - start_s, commanded_mm, where="post", label="commanded")
    axes.plot(steps.measured_s - start_s, 1e3 * (steps.measured_m - place_m), label="measured")
    axes.set(xlabel="time [s]", ylabel="position [mm]", title="Steps in free space")
    uncertainty_ms = 1e3 * SIGMAS * servo.deviation_s
    text = f"delay and lag {1e3 * servo.sum_s:.1f} +/- {uncertainty_ms:.1f} ms"
    axes.text(0.98, 0.05, text, transform=axes.transAxes, ha="right")
    axes.legend(loc="upper right")


def _plot_press(axes: "Axes", readings: "Readings") -> None:
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


def _plot_bode(axes: "Axes", advices: list[Advice]) -> None:
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


def _plot_releases(axes: "Axes", advices: list[Advice]) -> None:
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

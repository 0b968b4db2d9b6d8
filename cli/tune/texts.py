"""Text output of a tuning: a table, and a file that a cell file may include."""

from pathlib import Path

import yaml

from cli.calibration.output_files import back_up
from common.config.cell import CellConfig
from forcemesh.errors import DataError
from tuning.advice import Advice, MeasuredCell, RatedGain, refusal_reason, remarks
from tuning.servo import SIGMAS, Servo

HEAD = """\
# Measured by `forcemesh tune`: these values override those of a cell file that has the key
# `tuning: <this file>`. The stiffness is that of the surface pressed on: increase it when the tool
# may touch a stiffer one.
"""


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
        tau_ms, uncertainty_ms = (
            1e3 * measured.controller.tau_s,
            1e3 * SIGMAS * measured.controller.deviation_s,
        )
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
    file_ms = 1e3 * (cell.robot.delay_s + cell.robot.lag_s)
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
    settling = (
        "not settling" if forecast.settling_s is None else f"settles in {forecast.settling_s:.2f} s"
    )
    return (
        f"{settling}, overshoot {forecast.overshoot_pct:.0f} %; margins: phase "
        f"{found.phase_deg:.0f} degrees, gain x {found.gain:.1f}, delay "
        f"{1e3 * found.delay_s:.0f} ms"
    )


def save(path: Path, sections: dict[str, dict[str, float]]) -> None:
    """Write the file; a previous one is kept as `.before`. Raises DataError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        back_up(path)
        path.write_text(HEAD + _yaml(sections), encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def usage_advice(path: Path) -> str:
    """Return how to make a cell use the file."""
    return f"set `tuning: {path}`, relative to its folder, in the cell file to use it"


def _yaml(sections: dict[str, dict[str, float]]) -> str:
    text: str = yaml.safe_dump(sections, sort_keys=False)
    return text

"""A tuning in words: a table for people, and a file that a cell file may name."""

from pathlib import Path

import yaml

from cli.calibration.places import keep_before
from cli.tuning.advice import Advice, Judged, Measured
from common.cell import Cell
from common.errors import DataError

HEAD = """\
# What `forcemesh tune` has measured of this cell: it goes before the cell file's own numbers where
# that says `tuning: <this file>`. The stiffness is that of what was pressed on: raise it when the
# tool may touch something stiffer.
"""


def told(
    cell: Cell, measured: Measured, advices: list[Advice], sections: dict[str, dict[str, float]]
) -> list[str]:
    """Return the lines that a person reads."""
    servo, spring = measured.servo, measured.spring
    seen = f"delay {1e3 * servo.delay_s:.1f} ms and servo lag {1e3 * servo.lag_s:.1f} ms"
    file = f"{1e3 * cell.robot.delay_s:.1f} and {1e3 * cell.robot.lag_s:.1f} ms"
    lines = [f"{seen} from the command to the pose that is seen (cell file: {file})"]
    said = f"(cell file: {cell.contact.stiffness_N_m:.0f})"
    if spring is None:
        lines.append(f"stiffness not measured {said}: gains are for that")
    else:
        lines.append(f"stiffness {spring.k_N_m:.0f} +- {spring.spread_N_m:.0f} N/m {said}")
        lines.append("tilt stiffness is not measured: the cell file's, in proportion")
    for advice in advices:
        lines.append(f"host {advice.host}: tau {1e3 * advice.tau_s:.1f} ms")
        lines += _rows("position", "m/(N s)", advice.force_now, advice.force)
        lines += _rows("orientation", "rad/(N m s)", advice.torque_now, advice.torque)
    lines.append("for the cell file:")
    lines += [f"  {line}" for line in _yaml(sections).splitlines()]
    return lines


def _rows(what: str, unit: str, now: Judged, then: Judged) -> list[str]:
    return [
        f"  {what:<12} {name:<12} {one.gain:9.3g} {unit}: {_verdict(one)}"
        for name, one in (("now", now), ("recommended", then))
    ]


def _verdict(one: Judged) -> str:
    found, will = one.margins, one.forecast
    if not found.stable:
        return "NOT STABLE"
    if found.crossover_rad_s == 0.0:
        return "does nothing"
    takes = "never" if will.settling_s is None else f"in {will.settling_s:.2f} s"
    return (
        f"settles {takes}, overshoot {will.overshoot_pct:.0f} %; margins {found.phase_deg:.0f} "
        f"degrees, gain x {found.gain:.1f}, delay {1e3 * found.delay_s:.0f} ms"
    )


def save(path: Path, sections: dict[str, dict[str, float]]) -> None:
    """Write the file; what was there is kept beside it. Raises DataError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        keep_before(path)
        path.write_text(HEAD + _yaml(sections), encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def advice_for(path: Path) -> str:
    """Return what to do so that a cell uses the file."""
    return f"so that the cell uses it, let the cell file say `tuning: {path}`, seen from its folder"


def _yaml(sections: dict[str, dict[str, float]]) -> str:
    text: str = yaml.safe_dump(sections, sort_keys=False)
    return text

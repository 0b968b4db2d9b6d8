"""Sensor installation errors in a virtual cell, and their detection.

    python -m bench installations              the table, some ten minutes
    python -m bench.installations --write      the same into docs/installations.md

Three lines of defence are tested, each as if the previous ones had been skipped:
- `check axes`: the readings in six poses, as this installation shows them;
- arming: tare, rotate the wrist by hand, `arm` for force;
- the press: the error is hidden at rest, then the tool is pressed on a plate.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from rich.table import Table

from bench.installations_page import Outcome, page, short
from bench.installations_stage import (
    EYE,
    InstallationError,
    Stage,
    attitude_times,
    changed,
    readings_with,
    true_cell,
)
from bench.sensor_faults import PRESSED_N, TruthObserver
from forcemesh import topics
from forcemesh.errors import ConfigError, ForcemeshError
from forcemesh.requests import ArmRequest, Empty
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation
from tools.figures import as_block_page

PAGE = Path(__file__).resolve().parent.parent / "docs" / "installations.md"
PRESS_S, REST_S = 6.0, 0.1
NO_CELL = "nothing starts"
ALL, FORCES, TORQUES, UNITS = "all six channels", "forces", "torques", "units and payload"
KGF, LBF = 1.0 / 9.80665, 1.0 / 4.4482216


def wirings(group: str) -> Iterator[InstallationError]:
    """Yield the 47 wrong wirings of some channels."""
    for wiring in SIGNED[1:]:
        rows = [
            f"{'-' if row.min() < 0.0 else '+'}{'xyz'[int(np.argmax(abs(row)))]}" for row in wiring
        ]
        yield InstallationError(
            " ".join(rows),
            group,
            EYE if group == TORQUES else wiring,
            EYE if group == FORCES else wiring,
        )


def others() -> Iterator[InstallationError]:
    """Yield wrong units and payloads."""
    sensor = partial(InstallationError, group=UNITS)
    yield sensor("none: all correct")
    yield sensor("forces in kgf", force=KGF * EYE)
    yield sensor("forces in pounds", force=LBF * EYE)
    yield sensor("forces and torques in kgf, kgf m", force=KGF * EYE, torque=KGF * EYE)
    yield sensor("forces multiplied by 9.81", force=EYE / KGF)
    yield sensor("torques in N mm", torque=1e3 * EYE)
    yield sensor("torques in inch-pounds", torque=8.8507458 * EYE)
    degrees, radians = np.degrees(1.0), np.radians(1.0)
    yield sensor("attitudes: degrees for radians", attitude=partial(attitude_times, times=degrees))
    yield sensor("attitudes: radians for degrees", attitude=partial(attitude_times, times=radians))
    oat = {"sensor.T_flange_sensor.oat_deg": [round(float(np.radians(30.0)), 4), 0.0, 0.0]}
    yield sensor("oat_deg of the sensor in radians", changes=oat)
    for key, value in (
        ("tool.T_flange_tcp.position_m", [0.0, 0.0, 160.0]),
        ("sensor.T_flange_sensor.position_m", [0.0, 0.0, 20.0]),
        ("payload.com_m", [12.0, -8.0, 55.0]),
    ):
        yield sensor(f"{key} in mm", changes={key: value})
    for factor in (0.8, 1.2):
        yield sensor(
            f"payload.mass_kg: {factor:g} of the true value", changes={"payload.mass_kg": factor}
        )
    for axis in range(3):
        com = np.array([0.012, -0.008, 0.055])
        com[axis] += 0.02
        yield sensor(
            f"payload.com_m 20 mm off in {'xyz'[axis]}", changes={"payload.com_m": com.tolist()}
        )


def evaluate(mistake: InstallationError) -> Outcome:
    """Test the lines of defence that are relevant for a group.

    Torques have no effect on a straight press; errors of the forces press like all six channels.
    """
    try:
        configured = changed(true_cell(), mistake.changes)
    except ConfigError as error:
        refusal = f"the cell file is refused: {'; '.join(error.mistakes)}"
        return Outcome(
            mistake.name, mistake.group, "wrong", (refusal,), NO_CELL, NO_CELL, "", 0.0, 0.0
        )
    found = judge_installation(readings_with(mistake), ExpectedInstallation.of(configured))
    tare, arming = ("", "") if mistake.group == FORCES else _arming(mistake)
    press = ("", 0.0, 0.0) if mistake.group in (FORCES, TORQUES) else _press(mistake)
    return Outcome(
        mistake.name,
        mistake.group,
        found.verdict,
        tuple(str(finding) for finding in found.findings),
        tare,
        arming,
        *press,
    )


def _arming(mistake: InstallationError) -> tuple[str, str]:
    """Return why the tare, and arming for force with a rotated wrist, were refused."""
    stage = Stage(mistake)
    tare = stage.world.client.ask(topics.TARE, Empty())
    refused = "" if tare.accepted else f"{tare.code}: {tare.text}"
    try:
        stage.turn_wrist()
    except ForcemeshError as error:
        return refused, f"jog: {error}"
    reply = stage.world.client.ask(topics.ARM, ArmRequest())
    return refused, "" if reply.accepted else f"{reply.code}: {reply.text}"


def _press(mistake: InstallationError) -> tuple[str, float, float]:
    """Return why the press was stopped, its true peak force and its travel."""
    stage = Stage(mistake, hidden=True)
    client = stage.world.client
    client.ask(topics.TARE, Empty())
    stage.world.advance(REST_S)
    reply = client.ask(topics.ARM, ArmRequest())
    if not reply.accepted:
        return f"not armed: {reply.text}", 0.0, 0.0
    observer = TruthObserver(stage)
    try:
        stage.feedback(PRESSED_N, "pc")
    except ForcemeshError as error:
        return f"not started: {error}", 0.0, 0.0
    held_s = observer.until_held(PRESS_S)
    stopped = f"{observer.code()} after {1e3 * held_s:.0f} ms" if np.isfinite(held_s) else ""
    return stopped, observer.peak_N, observer.travel_m


def outcomes() -> list[Outcome]:
    """Test everything, on all cores."""
    mistakes = [*others(), *wirings(ALL), *wirings(FORCES), *wirings(TORQUES)]
    with ProcessPoolExecutor() as pool:
        return list(pool.map(evaluate, mistakes))


def table() -> Table:
    """Return the table of detections."""
    rows = Table(title="Sensor installation errors, virtual clock", title_justify="left")
    for name in (
        "installation",
        "error",
        "check axes",
        "tare",
        "arming",
        "press",
        "peak",
        "travel",
    ):
        rows.add_column(name)
    for outcome in outcomes():
        rows.add_row(
            outcome.group,
            outcome.mistake,
            f"{outcome.verdict}: {outcome.sentences}",
            short(outcome.tare),
            short(outcome.arming),
            outcome.press or "-",
            f"{outcome.peak_N:.1f} N",
            f"{1e3 * outcome.travel_m:.2f} mm",
        )
    return rows


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(prog="python -m bench.installations", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/installations.md")
    writes = parser.parse_args().write
    text = page(outcomes())
    if writes:
        command = "python -m bench.installations --write"
        PAGE.write_text(as_block_page("installations", text, command), encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()

"""Sensor installation errors in virtual cells, and their detection.

Three lines of defence are tested, each as if the previous ones had been skipped:
- `check axes`: the readings in six poses, as this installation shows them;
- arming: tare, rotate the wrist by hand, `arm` for force;
- the press: the error is hidden at rest, then the tool is pressed on a plate.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from math import isfinite

import numpy as np

from bench.harness import CaseTable, Options
from bench.installations_stage import (
    EYE,
    InstallationError,
    Stage,
    attitude_times,
    changed,
    readings_with,
    true_cell,
)
from bench.results import Row, Table, table
from bench.sensor_faults import PRESSED_N, TruthObserver, name_of
from forcemesh import topics
from forcemesh.errors import ConfigError, ForcemeshError
from forcemesh.requests import ArmRequest, Empty
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation

PRESS_S, REST_S, MOST_N = 6.0, 0.1, 10.0
NO_CELL = "nothing starts"
ALL, FORCES, TORQUES, UNITS = "all six channels", "forces", "torques", "units and payload"
KGF, LBF = 1.0 / 9.80665, 1.0 / 4.4482216


def wirings(group: str) -> Iterator[InstallationError]:
    """Yield the 47 wrong wirings of some channels."""
    for wiring in SIGNED[1:]:
        yield InstallationError(
            name_of(wiring),
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


def row(mistake: InstallationError) -> Row:
    """Test the lines of defence that are relevant for a group.

    Torques have no effect on a straight press; errors of the forces press like all six channels.
    """
    found: Row = {"group": mistake.group, "error": mistake.name}
    try:
        configured = changed(true_cell(), mistake.changes)
    except ConfigError as error:
        refusal = f"the cell file is refused: {'; '.join(error.mistakes)}"
        refused = {"result": refusal, "tare": NO_CELL, "arming": NO_CELL, "press": ""}
        return {**found, "detected": True, "harmless": True, **refused}
    judged = judge_installation(readings_with(mistake), ExpectedInstallation.of(configured))
    tare, arming = ("", "") if mistake.group == FORCES else _arming(mistake)
    press = {} if mistake.group in (FORCES, TORQUES) else _press(mistake)
    return {
        **found,
        "detected": judged.verdict == "wrong",
        "result": ". ".join(map(str, judged.findings)) or judged.verdict,
        "tare": short(tare),
        "arming": short(arming),
        **press,
    }


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


def _press(mistake: InstallationError) -> Row:
    """Return why the press was stopped, its true peak force and its travel."""
    stage = Stage(mistake, hidden=True)
    client = stage.world.client
    client.ask(topics.TARE, Empty())
    stage.world.advance(REST_S)
    reply = client.ask(topics.ARM, ArmRequest())
    if not reply.accepted:
        return {"press": f"not armed: {reply.text}", "harmless": True}
    observer = TruthObserver(stage)
    try:
        stage.feedback(PRESSED_N, "pc")
    except ForcemeshError as error:
        return {"press": f"not started: {error}", "harmless": True}
    held_s = observer.until_held(PRESS_S)
    return {
        "press": f"{observer.code()} after {1e3 * held_s:.0f} ms" if isfinite(held_s) else "",
        "peak_N": observer.peak_N,
        "travel_mm": 1e3 * observer.travel_m,
        "harmless": observer.peak_N < MOST_N,
    }


def short(answer: str) -> str:
    """Return the first reason of an answer, without code and advice."""
    words = answer.split(": ")
    return answer if len(words) < 3 else words[1]


ROWS = CaseTable(
    {
        "group": "", "error": "", "detected": "", "result": "", "tare": "", "arming": "",
        "press": "", "peak_N": ".1f", "travel_mm": ".2f",
    },
    [*others(), *wirings(ALL), *wirings(FORCES), *wirings(TORQUES)],
    row,
)  # fmt: skip
SUMMARY = {
    "group": "", "errors": "d", "detected_by_the_check": "d", "tare_or_arming_refused": "d",
    "harmless_press": "d", "none_of_these": "d", "met": "",
}  # fmt: skip
HARD = {"error": "", "arming": "", "press": "", "peak_N": ".1f", "travel_mm": ".2f"}


def measure(options: Options) -> dict[str, Table]:
    """Return every error, and how many of each group each line of defence finds."""
    rows = ROWS.measured(options)
    hard = [each for each in rows if not each.get("harmless", True)]
    return {
        "summary": table(SUMMARY, summary(rows)),
        "hard-presses": table(HARD, hard),
        "rows": ROWS.stored(rows),
    }


def summary(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the counts of a group; a line of defence that was not played has none."""
    for group in dict.fromkeys(each["group"] for each in rows):
        wrong = [r for r in rows if r["group"] == group and not r["error"].startswith("none")]
        refused = [bool(each["tare"] or each["arming"]) for each in wrong]
        harmless = [each.get("harmless", False) for each in wrong]
        found = [each["detected"] for each in wrong]
        passed = sum(not any(each) for each in zip(found, refused, harmless, strict=True))
        yield {
            "group": group,
            "errors": len(wrong),
            "detected_by_the_check": sum(found),
            "tare_or_arming_refused": None if group == FORCES else sum(refused),
            "harmless_press": None if group in (FORCES, TORQUES) else sum(harmless),
            "none_of_these": passed,
            "met": passed == 0,
        }

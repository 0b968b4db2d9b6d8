"""Fingerprint of a controller: what the readings of the probe mean, each with unit or reason.

What was not measured is null with its reason, and is in no other section of the file.
"""

from collections.abc import Iterator
from datetime import datetime
from typing import Any

from cli.probe.readings import MotionTrace, ProbeReadings, duration_s, ramp_s, trace_of
from cli.probe.stages import (
    JOINT_DEG,
    JOINT_MM_S,
    JOINT_S,
    OWN_ERROR,
    PERCENTS,
    PROCESS_TIME_OVER,
    SLOW_MM_S,
    SLOW_TRAVEL_MM,
    SPEED_MM_S,
    TRAVEL_MM,
    Found,
    middle_round_trip_s,
)
from common.config.probe import (
    MOST_MOTIONS_AHEAD,
    ProbedGateway,
    ProbedRobot,
    ProbeFile,
    ProbeResult,
)
from sim.controller.behaviour import Behaviour

SHORT_S = 0.2  # time-out given to TCP_RECV; a time-out of whole seconds is 1 s
LEAST_PLANNING_S = 1.5e-3  # what a motion without travel takes by itself is below
LEAST_STALL_S = 0.05  # a longer gap of a PC program during a motion instruction is a stall
MOST_EMULATED_AHEAD = 4
SLOWER = 10.0  # ramp at ACCEL 10
MORE_THAN_ASKED = 1.2  # a motion so much faster than asked for shows the floor of SPEED
BY_TIME = 1.5  # ramp at twice the speed: 1 if acceleration takes a time, 2 if it is constant
LEAST_SPREAD_S2 = 4e-6  # a lag of 2 ms
REFUSED = "the controller refused its line: error {code}"
LOADED_AS_COMMENT = "the controller did not accept its line on LOAD"
NOT_RUN = "stage {stage} was not run to its end"
UNITS = {"_hz": "Hz", "_s": "s", "_mm": "mm", ".mm": "mm", "mspeed": "%"}


def fingerprint(found: Found, *, now: datetime, controller: str, address: str) -> ProbeFile:
    """Return the content of probe.yaml."""
    results = dict(_plain(found.still)) | dict(_plain(found.wire))
    for name, reply in found.motion.items():
        results |= {f"{name}: {key}": value for key, value in _plain(reply)}
    meant = {**_of_stage_a(found), **_of_stage_b(found), **_of_stage_c(found)}
    behaviour = {name.removeprefix("behaviour."): result.value
                 for name, result in meant.items()
                 if name.startswith("behaviour.") and result.value is not None}  # fmt: skip
    return ProbeFile(
        measured_at=now,
        controller=controller,
        address=address,
        stages=tuple(found.stages),
        robot=_robot(meant),
        gateway=_gateway(meant),
        behaviour=_for_emulator(behaviour),
        results={**meant, **results},
        lines=found.still.checks,
    )


def _plain(readings: ProbeReadings) -> Iterator[tuple[str, ProbeResult]]:
    """Yield every reading as it was reported; the last of those with one name."""
    for name, values in readings.numbers.items():
        unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
        yield name, ProbeResult(value=values[-1], unit=unit)
    for name, code in readings.failed.items():
        yield name, ProbeResult(why=REFUSED.format(code=code) if code else LOADED_AS_COMMENT)


def _measured(value: float | bool | None, unit: str, why: str) -> ProbeResult:
    return (
        ProbeResult(value=value, unit=unit)
        if value is not None
        else ProbeResult(unit=unit, why=why)
    )


def _robot(meant: dict[str, ProbeResult]) -> ProbedRobot:
    ahead: Any = meant["behaviour.motions_ahead"].value
    delay_s: Any = meant["motion.delay_s"].value
    lag_s: Any = meant["motion.lag_s"].value
    return ProbedRobot(
        delay_s=delay_s,
        lag_s=lag_s,
        motions_ahead=None if ahead is None else max(1, min(int(ahead), MOST_MOTIONS_AHEAD)),
    )


def _gateway(meant: dict[str, ProbeResult]) -> ProbedGateway:
    least_segment_s: Any = meant["behaviour.least_segment_s"].value
    slowest_mm_s: Any = meant["motion.slowest_program_mm_s"].value
    least_m_s = None if slowest_mm_s is None else 1e-3 * slowest_mm_s
    return ProbedGateway(least_segment_s=least_segment_s, least_speed_m_s=least_m_s)


def _for_emulator(behaviour: dict[str, Any]) -> dict[str, Any]:
    """Return the measured answers that the emulated controller can give."""
    ahead, stall_s = behaviour.get("motions_ahead"), behaviour.get("planning_stall_s")
    if ahead is not None:
        behaviour["motions_ahead"] = max(1, min(int(ahead), MOST_EMULATED_AHEAD))
    if stall_s:
        behaviour["stall_at_motions"] = [1]
    return {name: value for name, value in behaviour.items() if name in Behaviour.model_fields}


# --- stage a --------------------------------------------------------------------------------------


def timer_grain(still: ProbeReadings) -> tuple[float | None, str]:
    """Return the grain of TIMER [s], or why it could not be measured."""
    least, reads, equal = (still.get(f"timer.{name}") for name in ("least_s", "reads", "equal"))
    if least is None or reads is None or equal is None:
        return None, "the lines with TIMER failed"
    if equal < 0.05 * reads:
        return None, f"finer than one step: each reading differs, by {least:.2g} s at least"
    return least, ""


def _of_stage_a(found: Found) -> dict[str, ProbeResult]:
    hz = found.still.get("steps.alone_hz")
    grain, why = timer_grain(found.still)
    absolute = found.still.get("switch.abs.speed")
    return {
        "behaviour.step_s": _measured(1.0 / hz if hz else None, "s", "steps.alone_hz is missing"),
        "behaviour.timer_grain_s": _measured(grain, "s", why),
        "behaviour.abs_speed": _measured(
            None if absolute is None else absolute != 0.0, "", "the switch could not be read"
        ),
    }


# --- stage b --------------------------------------------------------------------------------------


def _of_stage_b(found: Found) -> dict[str, ProbeResult]:
    names = ("whole_second_timeouts", "send_ignores_timeout", "tcp_error_stands",
             "pc_error_stops_robot")  # fmt: skip
    if "b" not in found.stages:
        why = NOT_RUN.format(stage="b")
        return {f"behaviour.{name}": ProbeResult(why=why) for name in names}
    wire = found.wire
    waited, longest = wire.numbers.get("idle.waited_s"), wire.get("flood.longest_s")
    ended, stands = wire.get("end.rst.ended"), wire.get("end.rst.stands")
    stopped = wire.get("stopped")
    stops = True if stopped == OWN_ERROR else None
    if stops is None and wire.get("pc_error.code") is not None:
        stops = False
    answers: tuple[bool | None, ...] = (
        None if not waited else waited[0] > 3.0 * SHORT_S,
        None if longest is None or longest < 0.5 else longest > 2.0,
        None if ended is None else bool(ended and stands),
        stops,
    )
    whys = ("TCP_RECV gave no result without data", "the PC's and the network's buffers took all",
            "the reset of the connection was not noticed",
            "the program fp.bad gave no result")  # fmt: skip
    rows = zip(names, answers, whys, strict=True)
    trip_s = middle_round_trip_s(found)
    return {f"behaviour.{name}": _measured(answer, "", why) for name, answer, why in rows} | {
        "round_trip_s": _measured(trip_s, "s", "no reply to echo"),
    }


# --- stage c --------------------------------------------------------------------------------------

OF_MOTION = {
    "behaviour.planning_stall_s": "s", "behaviour.segment_planning_s": "s",
    "behaviour.least_segment_s": "s",
    "behaviour.motions_ahead": "", "behaviour.joint_seconds_ignored": "",
    "behaviour.brake_keeps_prefetched": "", "motion.joint6_full_deg_s": "deg/s",
    "motion.linear_full_m_s": "m/s", "motion.turn_at_10_mm_s_deg_s": "deg/s",
    "motion.hold_resumes": "",
}  # fmt: skip
OF_RESPONSE = {
    "behaviour.least_speed_m_s": "m/s", "behaviour.accel_time_s": "s",
    "motion.delay_s": "s", "motion.lag_s": "s", "motion.speed_follows_monitor": "",
    "motion.speed_mm_s": "mm/s", "motion.slowest_program_mm_s": "mm/s", "motion.ramp_s": "s",
    "motion.acceleration_m_s2": "m/s^2", "motion.acceleration_by_time": "",
}  # fmt: skip


def _of_stage_c(found: Found) -> dict[str, ProbeResult]:
    units = OF_MOTION | OF_RESPONSE
    if "c" not in found.stages:
        why = NOT_RUN.format(stage="c")
        return {name: ProbeResult(unit=unit, why=why) for name, unit in units.items()}
    values = {
        **_stall(found), **_planning(found), **_segments(found), **_ahead(found),
        **_joints(found), **_stops(found), **_response(found),
    }  # fmt: skip
    return {name: _measured(values[name][0], unit, values[name][1])
            for name, unit in units.items()}  # fmt: skip


Values = dict[str, tuple[Any, str]]


def _value(found: Found, command: str, name: str) -> float | None:
    return found.motion[command].get(name) if command in found.motion else None


def _stall(found: Found) -> Values:
    name = "behaviour.planning_stall_s"
    idle, first = (_value(found, "first", f"gap.{which}_s") for which in ("idle", "first"))
    if idle is None or first is None:
        return {name: (None, "fp.guard gave no gaps")}
    if _value(found, "first", "gap.moved"):
        return {name: (None, "this run of fp.main had moved before: EXECUTE fp.main again")}
    gap = first - idle
    return {name: (gap if gap > LEAST_STALL_S else 0.0, "")}


def _planning(found: Found) -> Values:
    each = _value(found, "first", "planning_s")
    least = None if each is None else 0.0 if each < LEAST_PLANNING_S else each
    return {"behaviour.segment_planning_s": (least, "JMOVE gave no duration")}


def _segments(found: Found) -> Values:
    name = "behaviour.least_segment_s"
    if not found.segments:
        return {name: (None, "no series of segments was executed")}
    good = [asked for asked, code, _ in found.segments if code == 0]
    bad = [asked for asked, code, _ in found.segments if code == PROCESS_TIME_OVER]
    others = [code for _, code, _ in found.segments if code not in (0, PROCESS_TIME_OVER)]
    if not bad and others:
        return {name: (None, f"a series ended with the error {others[0]}")}
    if not bad:
        asked, _, took = found.segments[-1]
        return {name: (None, f"no E1117 down to {asked:.4f} s, {took:.4f} s from one to the next")}
    if not good:
        return {name: (None, f"E1117 already at {max(bad):g} s")}
    return {name: ((max(bad) * min(good)) ** 0.5, "")}


def _ahead(found: Found) -> Values:
    count = _value(found, "ahead", "ahead")
    why = "the program passed no motion instruction in half a second"
    return {"behaviour.motions_ahead": (int(count) if count else None, why)}


def _joints(found: Found) -> Values:
    took_s = _value(found, "joint s", "joint.took_s")
    ignored = None if took_s is None else took_s < 0.75 * JOINT_S
    percent_deg_s = _rate(found, "joint %", PERCENTS)
    full_deg_s = None if percent_deg_s is None else 100.0 * percent_deg_s
    at_mm_s = _rate(found, "joint mm/s", 1.0)
    linear_m_s = None
    if full_deg_s and at_mm_s:
        linear_m_s = 1e-3 * JOINT_MM_S * full_deg_s / at_mm_s
    turned_s = _value(found, "turn mm/s", "turn.took_s")
    why = "the durations of the turns do not differ"
    return {
        "behaviour.joint_seconds_ignored": (ignored, "JMOVE gave no duration"),
        "motion.joint6_full_deg_s": (full_deg_s, why),
        "motion.linear_full_m_s": (linear_m_s, why),
        "motion.turn_at_10_mm_s_deg_s": (
            JOINT_DEG / turned_s if turned_s else None,
            "LMOVE gave no duration",
        ),
    }


def _rate(found: Found, command: str, divided_by: float) -> float | None:
    """Return the speed of JT6 from two angles, which cancels ramps and settling [deg/s]."""
    once, twice = (_value(found, f"{command} {factor}", "joint.took_s") for factor in (1, 2))
    if once is None or twice is None or twice - once < 1e-3:
        return None
    return JOINT_DEG / (twice - once) / divided_by


def _stops(found: Found) -> Values:
    done, braked_mm = (_value(found, "brake", f"brake.{name}") for name in ("done", "mm"))
    keeps = None
    if done == 2.0 and braked_mm is not None:
        keeps = braked_mm > 0.9 * TRAVEL_MM
    end_mm, held = _value(found, "hold", "hold.end_mm"), _value(found, "hold", "hold.task")
    return {
        "behaviour.brake_keeps_prefetched": (keeps, "BRAKE of the PC program was not executed"),
        "motion.hold_resumes": (
            None if end_mm is None or not held else end_mm > 3.5,
            "MC HOLD of the PC program was not executed",
        ),
    }


def _trace(found: Found, name: str, travel_mm: float = TRAVEL_MM) -> MotionTrace | None:
    samples = found.motion[name].samples if name in found.motion else ()
    return trace_of(samples, travel_mm)


def _response(found: Found) -> Values:
    """Delay, lag and ramps: half the travel is passed after delay, lag and half the duration."""
    why = "too few samples of the arm"
    values: Values = dict.fromkeys(OF_RESPONSE, (None, why))
    values["motion.speed_follows_monitor"] = (
        found.follows, "above 67 % monitor speed a motion does not show it"
    )  # fmt: skip
    slowest_mm_s, slow_why = _slowest(found)
    values["motion.slowest_program_mm_s"] = (slowest_mm_s, slow_why)
    if slowest_mm_s is not None:
        has_floor = slowest_mm_s > MORE_THAN_ASKED * SLOW_MM_S / found.scale
        values["behaviour.least_speed_m_s"] = (1e-3 * slowest_mm_s if has_floor else 0.0, "")
    line = _trace(found, "line")
    if line is None:
        return values
    values["motion.speed_mm_s"] = (line.speed_mm_s, "")
    ramp, fast_ramp = _ramp(found, "line", SPEED_MM_S), _ramp(found, "line fast", 2 * SPEED_MM_S)
    if ramp and fast_ramp:
        values["motion.ramp_s"] = (ramp, "")
        values["motion.acceleration_m_s2"] = (1e-3 * SPEED_MM_S / ramp, "")
        by_time = fast_ramp < BY_TIME * ramp
        values["motion.acceleration_by_time"] = (by_time, "")
        values["behaviour.accel_time_s"] = (ramp / found.scale if by_time else 0.0, "")
    sum_s = max(0.0, line.half_s - 0.5 * duration_s(TRAVEL_MM, SPEED_MM_S, ramp))
    spread_s2 = line.spread_s2 - ramp * ramp / 12.0
    if spread_s2 < LEAST_SPREAD_S2:
        values["motion.delay_s"] = (sum_s, "")
        values["motion.lag_s"] = (None, "too short for the samples: it is part of motion.delay_s")
        return values
    lag_s = min(spread_s2**0.5, sum_s)
    values["motion.delay_s"] = (sum_s - lag_s, "")
    values["motion.lag_s"] = (lag_s, "")
    return values


def _ramp(found: Found, name: str, speed_mm_s: float) -> float:
    """Return the time to a speed at ACCEL 100 [s], 0 without samples."""
    full, slow = _trace(found, name), _trace(found, f"{name} ramp")
    if full is None or slow is None:
        return 0.0
    later_s = max(0.0, slow.half_s - full.half_s)
    return ramp_s(TRAVEL_MM, speed_mm_s, slower=SLOWER, later_s=later_s)


def _slowest(found: Found) -> tuple[float | None, str]:
    """Return the program speed at which a very slow motion goes: asked for, or the floor of SPEED.

    Slower is not asked for.
    """
    slow = _trace(found, "line slow", SLOW_TRAVEL_MM)
    return (None, "too few samples of the arm") if slow is None else (
        slow.speed_mm_s / found.scale, ""
    )  # fmt: skip

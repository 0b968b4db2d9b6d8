"""Fingerprint: a value with its unit, or null with the reason; never a guess."""

from datetime import UTC, datetime

import pytest

from cli.probe.fingerprint import fingerprint
from cli.probe.readings import ProbeReadings, duration_s
from cli.probe.stages import Found
from common.config.probe import ProbeFile, ProbeResult

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def readings(**values: float) -> ProbeReadings:
    """Return a reply; a double underscore stands for a dot."""
    return ProbeReadings(
        numbers={name.replace("__", "."): [value] for name, value in values.items()}
    )


def file_of(found: Found) -> ProbeFile:
    """Return the fingerprint."""
    return fingerprint(found, now=NOW, controller="F60", address="h:1")


def result_of(found: Found, name: str) -> ProbeResult:
    """Return one result of the fingerprint."""
    return file_of(found).results[name]


def in_motion(**motion: ProbeReadings) -> Found:
    """Return findings whose stage c gave these replies; a single underscore stands for a blank."""
    return Found(["a", "b", "c"], motion={k.replace("_", " "): v for k, v in motion.items()})


def series(*rows: tuple[float, int]) -> Found:
    """Return findings with these series of segments."""
    return Found(["a", "b", "c"], segments=[(asked_s, code, asked_s) for asked_s, code in rows])


@pytest.mark.parametrize("stages", [[], ["a"], ["a", "b"], ["a", "b", "c"]])
def test_what_was_not_measured_is_null_with_a_reason(stages: list[str]) -> None:
    """And in neither section that others read."""
    file = file_of(Found(stages))
    assert file.behaviour == {}
    assert not file.robot.model_dump(exclude_none=True)
    assert not file.gateway.model_dump(exclude_none=True)
    assert all(result.value is None and result.why for result in file.results.values())
    assert (file.measured_at, file.controller, file.address) == (NOW, "F60", "h:1")
    reasons = {result.why for result in file.results.values()}
    assert ("stage c was not run to its end" in reasons) is ("c" not in stages)


def test_readings_have_their_units_and_refused_lines_their_code() -> None:
    """A line that became a comment on LOAD has none."""
    still = readings(steps__alone_hz=2000.0, mspeed=50.0, tool_mm=1.5, task__1=0.0)
    still.failed = {"switch.x": -10116, "switch.y": 0}
    results = file_of(Found(["a"], still=still)).results
    units = {name: results[name].unit for name in still.numbers}
    assert units == {"steps.alone_hz": "Hz", "mspeed": "%", "tool_mm": "mm", "task.1": ""}
    assert results["behaviour.step_s"] == ProbeResult(value=0.0005, unit="s")
    assert "error -10116" in results["switch.x"].why
    assert "LOAD" in results["switch.y"].why


@pytest.mark.parametrize(
    ("equal", "value", "why"), [(500.0, 0.004, ""), (10.0, None, "finer than one step")]
)
def test_the_grain_of_timer_needs_equal_readings(
    equal: float, value: float | None, why: str
) -> None:
    """Otherwise the steps between the readings are what was measured."""
    still = readings(timer__least_s=0.004, timer__reads=1000.0, timer__equal=equal)
    found = result_of(Found(["a"], still=still), "behaviour.timer_grain_s")
    assert found.value == value
    assert why in found.why


@pytest.mark.parametrize(
    ("rows", "value", "why"),
    [
        ([(0.04, 0), (0.03, -31117), (0.036, 0)], (0.036 * 0.03) ** 0.5, ""),
        ([(0.04, 0), (0.03, 0)], None, "no E1117 down to 0.0300 s"),
        ([(0.1, -31117)], None, "already at 0.1 s"),
        ([(0.1, 0), (0.08, -36007)], None, "ended with the error -36007"),
        ([], None, "no series"),
    ],
)
def test_the_least_segment_is_between_a_series_that_passed_and_one_that_failed(
    rows: list[tuple[float, int]], value: float | None, why: str
) -> None:
    """Anything else is no measurement."""
    file = file_of(series(*rows))
    found = file.results["behaviour.least_segment_s"]
    assert found.value == (None if value is None else pytest.approx(value))
    assert why in found.why
    assert file.gateway.least_segment_s == found.value


@pytest.mark.parametrize(("count", "cell", "emulator"), [(1, 1, 1), (6, 6, 4), (12, 10, 4)])
def test_more_motions_ahead_than_a_file_takes_are_limited(
    count: int, cell: int, emulator: int
) -> None:
    """The result itself has what was counted."""
    file = file_of(in_motion(ahead=readings(ahead=count)))
    assert file.results["behaviour.motions_ahead"].value == count
    assert file.robot.motions_ahead == cell
    assert file.behaviour["motions_ahead"] == emulator


def test_no_motion_that_was_passed_is_no_count() -> None:
    """Half a second was too short for a slow controller."""
    assert result_of(in_motion(ahead=readings(ahead=0.0)), "behaviour.motions_ahead").value is None


def test_a_stall_needs_the_first_motion_of_a_run() -> None:
    """Only that one is known to plan longest."""
    gaps = {"gap__idle_s": 0.02, "gap__first_s": 0.52}
    first = file_of(in_motion(first=readings(gap__moved=0.0, **gaps))).behaviour
    assert first["planning_stall_s"] == pytest.approx(0.5)
    assert first["stall_at_motions"] == [1]
    later = file_of(in_motion(first=readings(gap__moved=1.0, **gaps)))
    assert "EXECUTE fp.main again" in later.results["behaviour.planning_stall_s"].why
    none = file_of(in_motion(first=readings(gap__moved=0.0, gap__idle_s=0.02, gap__first_s=0.03)))
    assert none.behaviour == {"planning_stall_s": 0.0}


@pytest.mark.parametrize(("each_s", "value"), [(0.0004, 0.0), (0.004, 0.004)])
def test_planning_is_what_a_motion_costs_the_program(each_s: float, value: float) -> None:
    """Below a millisecond or so it cannot be separated from the motion itself."""
    found = in_motion(first=readings(planning_s=each_s))
    assert result_of(found, "behaviour.segment_planning_s").value == value


def trace(half_s: float, speed_mm_s: float, travel_mm: float) -> ProbeReadings:
    """Return the samples of a motion that passes the middle of its travel at a time."""
    reply = readings(move__took_s=0.5)
    reply.samples = [(half_s + k * 0.01, 0.5 * travel_mm + k * 0.01 * speed_mm_s)
                     for k in range(-40, 40)
                     if abs(k * 0.01 * speed_mm_s) < 0.5 * travel_mm]  # fmt: skip
    return reply


@pytest.mark.parametrize(("scale", "speed", "floor"), [(0.5, 0.2, 0.0), (0.5, 0.6, 0.0012)])
def test_a_motion_faster_than_asked_for_shows_the_floor_of_speed(
    scale: float, speed: float, floor: float
) -> None:
    """As a program speed: the monitor speed is not in it."""
    found = in_motion(line_slow=trace(1.0, speed, 0.4))
    found.scale = scale
    results = file_of(found).results
    assert results["motion.slowest_program_mm_s"].value == pytest.approx(speed / scale)
    assert results["behaviour.least_speed_m_s"].value == pytest.approx(floor)


@pytest.mark.parametrize(("factor", "by_time"), [(1.0, True), (2.0, False)])
def test_acceleration_is_constant_or_takes_a_time(factor: float, by_time: bool) -> None:
    """At twice the speed a constant one needs twice the ramp."""
    found, ramp = Found(["a", "b", "c"]), 0.02
    for name, speed, full in (("line", 10.0, ramp), ("line fast", 20.0, factor * ramp)):
        longer_s = duration_s(5.0, speed, 10.0 * full) - duration_s(5.0, speed, full)
        found.motion[name] = trace(0.3, speed, 5.0)
        found.motion[f"{name} ramp"] = trace(0.3 + 0.5 * longer_s, speed, 5.0)
    found.scale = 0.5
    results = file_of(found).results
    assert results["motion.ramp_s"].value == pytest.approx(ramp, rel=1e-3)
    assert results["motion.acceleration_by_time"].value is by_time
    at_full_speed_s = ramp / found.scale if by_time else 0.0
    assert results["behaviour.accel_time_s"].value == pytest.approx(at_full_speed_s, rel=1e-3)


@pytest.mark.parametrize(
    ("done", "mm", "value"), [(2.0, 0.6, False), (2.0, 5.0, True), (1.0, 5.0, None)]
)
def test_brake_counts_only_when_it_was_executed(done: float, mm: float, value: bool | None) -> None:
    """Otherwise the arm came to the end without it."""
    found = in_motion(brake=readings(brake__done=done, brake__mm=mm))
    assert result_of(found, "behaviour.brake_keeps_prefetched").value is value


def test_turns_that_take_the_same_time_give_no_speed() -> None:
    """A difference is what cancels ramps and settling."""
    same = readings(joint__took_s=0.4)
    found = in_motion(joint_s=same)
    found.motion |= {f"joint {unit} {k}": same for unit in ("%", "mm/s") for k in (1, 2)}
    results = file_of(found).results
    assert results["behaviour.joint_seconds_ignored"].value is True
    assert results["motion.joint6_full_deg_s"].value is None
    assert results["motion.linear_full_m_s"].why == "the durations of the turns do not differ"


@pytest.mark.parametrize(
    ("numbers", "name", "value"),
    [
        ({"pc_error.code": [0.0]}, "pc_error_stops_robot", False),
        ({"stopped": [-30108.0]}, "pc_error_stops_robot", True),
        ({"stopped": [-30999.0]}, "pc_error_stops_robot", None),
        ({"flood.longest_s": [0.2]}, "send_ignores_timeout", None),
        ({"flood.longest_s": [3.4]}, "send_ignores_timeout", True),
        ({"idle.waited_s": [1.0, 2.0]}, "whole_second_timeouts", True),
        ({"end.rst.ended": [1.0], "end.rst.stands": [0.0]}, "tcp_error_stands", False),
        ({"end.rst.ended": [1.0], "end.rst.stands": [1.0]}, "tcp_error_stands", True),
    ],
)
def test_the_socket_answers_by_its_readings(
    numbers: dict[str, list[float]], name: str, value: bool | None
) -> None:
    """A reading that shows neither answer gives none."""
    found = Found(["a", "b"], wire=ProbeReadings(numbers=numbers), round_trips_s=[0.01, 0.02, 0.03])
    file = file_of(found)
    assert file.results[f"behaviour.{name}"].value is value
    assert file.results["round_trip_s"].value == 0.02
    assert file.behaviour == ({} if value is None else {name: value})


def test_a_lag_too_short_for_the_samples_is_part_of_the_delay() -> None:
    """Their sum is known all the same."""
    line = readings(move__took_s=0.5)
    line.samples = [(0.01 * k, max(0.0, 0.1 * (k - 2))) for k in range(53)]
    found = in_motion(line=line)
    file = file_of(found)
    assert file.robot.delay_s == pytest.approx(0.02, abs=1e-6)
    assert file.robot.lag_s is None
    assert file.results["motion.ramp_s"].value is None

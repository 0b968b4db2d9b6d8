"""Fingerprint: a value with its unit, or null with the reason; never a guess.

The values themselves: tests/unit/controller/test_fmprobe_as.py, against the emulated controller.
"""

from datetime import UTC, datetime

import pytest

from cli.probe.fingerprint import fingerprint
from cli.probe.readings import ProbeReadings
from cli.probe.stages import Found
from common.config.probe import ProbeFile

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def readings(**values: float) -> ProbeReadings:
    """Return a reply; a double underscore stands for a dot."""
    return ProbeReadings(
        numbers={name.replace("__", "."): [value] for name, value in values.items()}
    )


def file_of(found: Found) -> ProbeFile:
    """Return the fingerprint."""
    return fingerprint(found, now=NOW, controller="F60", address="h:1")


def in_motion(**motion: ProbeReadings) -> Found:
    """Return findings whose stage c gave these replies; a single underscore stands for a blank."""
    return Found(["a", "b", "c"], motion={k.replace("_", " "): v for k, v in motion.items()})


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


@pytest.mark.parametrize(("count", "cell", "emulator"), [(6, 6, 4), (12, 10, 4)])
def test_more_motions_ahead_than_a_file_takes_are_limited(
    count: int, cell: int, emulator: int
) -> None:
    """The result itself has what was counted."""
    file = file_of(in_motion(ahead=readings(ahead=count)))
    assert file.results["behaviour.motions_ahead"].value == count
    assert file.robot.motions_ahead == cell
    assert file.behaviour["motions_ahead"] == emulator


def test_a_lag_too_short_for_the_samples_is_part_of_the_delay() -> None:
    """Their sum is known all the same."""
    line = readings(move__took_s=0.5)
    line.samples = [(0.01 * k, max(0.0, 0.1 * (k - 2))) for k in range(53)]
    found = in_motion(line=line)
    file = file_of(found)
    assert file.robot.delay_s == pytest.approx(0.02, abs=1e-6)
    assert file.robot.lag_s is None
    assert file.results["motion.ramp_s"].value is None


SAME_TURNS = {
    f"joint {unit} {number}": readings(joint__took_s=0.4)
    for unit in ("%", "mm/s") for number in (1, 2)
}  # fmt: skip
LATER = {"gap__moved": 1.0, "gap__idle_s": 0.02, "gap__first_s": 0.52}


@pytest.mark.parametrize(
    ("found", "name", "why"),
    [
        (Found(segments=[(0.04, 0, 0.04), (0.03, 0, 0.03)]), "least_segment_s",
         "no E1117 down to 0.0300 s"),
        (Found(segments=[(0.1, -31117, 0.1)]), "least_segment_s", "already at 0.1 s"),
        (Found(segments=[(0.08, -36007, 0.08)]), "least_segment_s", "the error -36007"),
        (Found(), "least_segment_s", "no series"),
        (Found(motion={"ahead": readings(ahead=0.0)}), "motions_ahead", ""),
        (Found(motion={"first": readings(**LATER)}), "planning_stall_s", "EXECUTE fp.main again"),
        (Found(motion={"brake": readings(brake__done=1.0, brake__mm=5.0)}),
         "brake_keeps_prefetched", ""),  # it came to the end without it
        (Found(motion=SAME_TURNS), "joint6_full_deg_s", "the durations of the turns do not differ"),
        (Found(wire=readings(stopped=-30999.0)), "pc_error_stops_robot", ""),
        (Found(wire=readings(flood__longest_s=0.2)), "send_ignores_timeout", ""),
        (Found(still=readings(timer__least_s=0.004, timer__reads=1000.0, timer__equal=10.0)),
         "timer_grain_s", "finer than one step"),
    ],
)  # fmt: skip
def test_a_reading_that_shows_no_value_is_null_with_its_reason(
    found: Found, name: str, why: str
) -> None:
    """And in no section that others read."""
    found.stages = ["a", "b", "c"]
    file = file_of(found)
    results = file.results
    result = results.get(f"behaviour.{name}") or results[f"motion.{name}"]
    assert result.value is None
    assert why in result.why
    assert name not in file.behaviour

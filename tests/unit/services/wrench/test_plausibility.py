"""Faults of the sensor: each makes the wrench not valid with its own code, in time, never zero.

H25 not finite, H26 silent and frozen, H27 saturated, H33 wrench and pose apart in time.
"""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.load import cell_from_tree
from forcemesh.errors import ConfigError
from forcemesh.faults import FAULTS
from services.wrench.plausibility import ReadingCheck, ReadingLimits
from tests.fakes.bench import CELL
from tests.fakes.wrench_bench import SENSOR_S

BOUNDS = ReadingLimits.of(CELL)
REST = np.array([1.0, -2.0, 12.0, 0.1, 0.2, 0.3])


def codes(readings: list[np.ndarray], bounds: ReadingLimits = BOUNDS) -> list[str]:
    """Return the code of each reading of a stream."""
    check, found = ReadingCheck(bounds), []
    for reading in readings:
        fault = check.fault_of(tuple(reading.tolist()), SENSOR_S)
        assert check.accepted or fault is not None or check.spikes
        found.append("" if fault is None else fault.code)
    return found


# --- pure -----------------------------------------------------------------------------------------


@given(st.integers(0, 5), st.sampled_from([np.nan, np.inf, -np.inf]))
def test_a_number_that_is_not_finite_is_reported_with_its_axis(axis: int, value: float) -> None:
    """H25: the first such sample is reported, also the first one of all."""
    bad = REST.copy()
    bad[axis] = value
    assert codes([bad]) == ["not_finite"]
    assert codes([REST, bad, REST + 0.01]) == ["", "not_finite", ""]


@given(st.integers(0, 5), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 1e300))
def test_a_reading_at_95_percent_of_the_range_does_not_count(axis, sign, beyond) -> None:
    """H27: any axis alone, either sign; the number just below the limit counts."""
    for share, code in ((0.95 + beyond, "sensor_saturated"), (np.nextafter(0.95, 0.0), "")):
        reading = REST.copy()
        reading[axis] = sign * share * BOUNDS.range[axis]
        assert codes([reading]) == [code]


@given(hnp.arrays(float, 6, elements=st.floats(-5.0, 5.0)), st.integers(0, 5))
def test_a_constant_reading_is_frozen_in_time(reading, axis) -> None:
    """H26: 80 ms after the last change, within 100 ms; a change of one number ends it."""
    changed = reading + 1e-6 * np.eye(6)[axis]
    frozen_for = round(CELL.sensor.frozen_s / SENSOR_S) + 1
    found = codes([changed, *[reading] * (frozen_for + 1), changed])
    assert found == [""] * frozen_for + ["sensor_frozen"] * 2 + [""]


def test_a_sensor_without_noise_is_configured_in_the_cell_file() -> None:
    """With 0 nothing counts as frozen; a noiseless simulated sensor requires it."""
    ideal = CELL.sensor.model_copy(update={"frozen_s": 0.0})
    bounds = ReadingLimits.of(CELL.model_copy(update={"sensor": ideal}))
    assert set(codes([REST] * 1000, bounds)) == {""}
    tree: dict[str, Any] = CELL.model_dump(mode="json")
    tree["sim"] |= {"noise_force_N": 0.0, "noise_torque_Nm": 0.0}
    with pytest.raises(ConfigError, match=r"frozen_s must be 0"):
        cell_from_tree(tree, "a cell")
    tree["sensor"]["frozen_s"] = 0.0
    assert cell_from_tree(tree, "a cell").sensor.frozen_s == 0.0


@given(st.lists(hnp.arrays(float, 6, elements=st.floats(allow_nan=True)), max_size=20))
def test_every_reading_counts_is_reported_or_is_one_spike(readings) -> None:
    """For any readings nothing raises, and no two in a row are dropped without a report."""
    check, unreported = ReadingCheck(BOUNDS), 0
    for reading in readings:
        fault = check.fault_of(tuple(reading.tolist()), SENSOR_S)
        unreported = 0 if check.accepted or fault is not None else unreported + 1
        assert unreported <= 1
        assert fault is None or fault.code in FAULTS


# --- exact limits ---------------------------------------------------------------------------------

PERIOD_S = 2.0**-6  # sums of it are exact
EXACT = ReadingLimits(
    range=(100.0, 100.0, 100.0, 10.0, 10.0, 10.0),
    step=(16.0, 2.0),
    step_per_s=(64.0, 8.0),
    frozen_s=4.0 * PERIOD_S,
)


def last_of(*readings: np.ndarray, period_s: float = PERIOD_S) -> tuple[ReadingCheck, str]:
    """Return the check after these readings, and the code of the last one."""
    check, fault = ReadingCheck(EXACT), None
    for reading in readings:
        fault = check.fault_of(tuple(reading.tolist()), period_s)
    return check, "" if fault is None else fault.code


def last_code(*readings: np.ndarray, period_s: float = PERIOD_S) -> str:
    """Return the code of the last of these readings."""
    return last_of(*readings, period_s=period_s)[1]


def axis_reading(number: int, value: float) -> np.ndarray:
    """Return a reading that is zero on all other axes."""
    return value * np.eye(6)[number]


def test_the_reading_limits_of_the_demo_follow_from_its_cell() -> None:
    """1.2 kg at 0.25 m/s stop within 2 ms on 20 N/mm, 0.1 m beyond a TCP 0.14 m away; 2 % more."""
    bounds = ReadingLimits.of(CELL)
    assert bounds.range == (500.0, 500.0, 500.0, 20.0, 20.0, 20.0)
    assert bounds.step == pytest.approx([10.0 + 150.0, 0.4 + 0.24 * 150.0])
    assert bounds.step_per_s == pytest.approx([5000.0, 0.24 * 5000.0])
    assert bounds.frozen_s == 0.08


@pytest.mark.parametrize(
    ("period_s", "repeats", "code"),
    [
        (PERIOD_S, 3, ""),
        (PERIOD_S, 4, "sensor_frozen"),
        (4.0 * PERIOD_S, 2, ""),
        (4.0 * PERIOD_S, 3, "sensor_frozen"),
    ],
)
def test_a_sensor_is_frozen_after_its_time_and_three_repeats(
    period_s: float, repeats: int, code: str
) -> None:
    """The later of both counts, from the first reading on as after any other."""
    one, other = axis_reading(0, 1.0), axis_reading(0, 2.0)
    assert last_code(*[one] * (1 + repeats), period_s=period_s) == code
    assert last_code(*[other] * 3, *[one] * (1 + repeats), period_s=period_s) == code


@pytest.mark.parametrize(("number", "step", "per_s"), [(1, 16.0, 64.0), (4, 2.0, 8.0)])
@pytest.mark.parametrize("lost", [0, 1])
def test_the_largest_step_grows_with_the_time_since_the_last_reading_that_counted(
    number: int, step: float, per_s: float, lost: int
) -> None:
    """The largest step itself is an impact; the next number is a jump if a second one follows."""
    largest = step + per_s * (1 + lost) * PERIOD_S
    first, wild = axis_reading(number, -0.5 * step), [axis_reading(number, 4.5 * step)] * lost
    for change, counts in ((largest, True), (np.nextafter(largest, np.inf), False)):
        check, _ = last_of(first, *wild, first + axis_reading(number, change))
        assert check.accepted is counts
        assert check.spikes == max(lost, not counts)


def test_the_largest_steps_of_force_and_torque_at_once_count() -> None:
    """Force and torque have separate limits; each uses the norm of its three axes."""
    force_N, torque_Nm = 16.0 + 64.0 * PERIOD_S, 2.0 + 8.0 * PERIOD_S
    both = axis_reading(0, force_N) + axis_reading(3, torque_Nm)
    assert last_of(np.zeros(6), both)[0].accepted
    for addition in (
        axis_reading(1, 0.1 * force_N),
        axis_reading(2, 0.1 * force_N),
        axis_reading(4, 0.3),
        axis_reading(5, 0.3),
    ):
        assert not last_of(np.zeros(6), both + addition)[0].accepted


@pytest.mark.parametrize(("calm", "code"), [(9, "sensor_jump"), (10, "")])
@pytest.mark.parametrize("wild_before", [1, 2])
def test_ten_calm_readings_make_the_next_outlier_a_spike_again(
    calm: int, code: str, wild_before: int
) -> None:
    """This holds after a spike and after a jump; after one calm reading less it is a fault."""
    wild = axis_reading(2, 90.0)
    before = [
        axis_reading(2, 0.0),
        *[wild + axis_reading(2, float(each)) for each in range(wild_before)],
    ]
    after = [axis_reading(2, 0.01 * each) for each in range(calm)]
    assert last_code(*before, *after, wild) == code


def test_a_cleared_check_is_a_new_one_that_remembers_its_spikes() -> None:
    """After a gap the first reading counts, and neither jump nor frozen time remains."""
    assert not ReadingCheck(EXACT).accepted
    wild, still = axis_reading(0, 90.0), [axis_reading(1, 1.0)] * 4
    check, _ = last_of(*still, wild)
    check.clear()
    assert not check.accepted
    for reading in (wild, wild, wild):
        assert check.fault_of(tuple(reading.tolist()), PERIOD_S) is None
        assert check.accepted
    assert check.spikes == 1

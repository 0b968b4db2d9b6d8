"""The three rules of a stream of set points, each at its last digit, for travel and for turns."""

from collections.abc import Callable
from math import nextafter, radians

import pytest

from common.config.load import load_cell
from common.motion.limits import Limits
from common.motion.setpoint_monitor import SetpointMonitor
from forcemesh.messages import Trip
from tests.contract.rig import DEMO_CELL
from tests.fakes.arbiter_world import displaced

MS = 1_000_000
START_NS = 10**12  # of a stream: clocks begin nowhere in particular
CELL = load_cell(DEMO_CELL)
# Of the demo's cell: 0.25 m/s and 60 degrees/s, 2 m/s2 and 480 degrees/s2.
SPEEDS = (0.25, radians(60.0))
ACCELS = (2.0, radians(480.0))
# As docs/reliability.md and docs/arbitration.md have them, not as the code under test has.
WINDOW = 1.25 * 0.25  # of the speed, in any 250 ms
SUDDEN = tuple(1.5 * a * 0.06**2 + v * 0.02 for v, a in zip(SPEEDS, ACCELS, strict=True))
WIDE = {"step_m": 0.2, "step_deg": 90.0}
ROUND = {"accel_m_s2": 20.0, "accel_deg_s2": 5000.0}  # what starts suddenly enough for any test
LITTLE = 1e-7  # as a share
each_kind = pytest.mark.parametrize("kind", [0, 1], ids=["travel", "turn"])


def begun(kind: int, **changes: float) -> SetpointMonitor:
    """Return a monitor whose stream begins at the origin."""
    limits = CELL.limits.model_copy(update=changes)
    monitor = SetpointMonitor(Limits.of(CELL.model_copy(update={"limits": limits})))
    assert monitor.begin(displaced(kind, 0.0), START_NS) is None
    return monitor


def code(trip: Trip | None) -> str:
    """Return the rule, or nothing."""
    return "" if trip is None else trip.code


# --- one set point --------------------------------------------------------------------------------

STEPS = (0.02, radians(10.0))  # of the demo's cell


@each_kind
def test_a_stream_begins_with_one_step_and_not_more(kind: int) -> None:
    """A refused set point uses nothing up; the trip names the speed that was broken."""
    monitor = begun(kind, **ROUND)
    trip = monitor.check(displaced(kind, STEPS[kind] * (1.0 + LITTLE)), START_NS)
    assert trip is not None
    assert (trip.code, trip.limit) == ("speed", SPEEDS[kind])
    assert monitor.check(displaced(kind, STEPS[kind] * (1.0 - LITTLE)), START_NS) is None
    assert code(monitor.check(displaced(kind, STEPS[kind] * (1.0 + LITTLE)), START_NS)) == "speed"


# The travel's differences are exact, and the turn comes back from its rotation unchanged.
@pytest.mark.parametrize(("kind", "step"), [(0, 2.0**-7), (1, radians(10.0))])
def test_a_step_itself_may_be_gone(kind: int, step: float) -> None:
    """To the last digit, in numbers that are exact; and it is used up to the last digit."""
    monitor = begun(kind, **(ROUND | {"step_m": 2.0**-7}))
    assert code(monitor.check(displaced(kind, nextafter(step, 1.0)), START_NS)) == "speed"
    assert monitor.check(displaced(kind, step), START_NS) is None
    assert code(monitor.check(displaced(kind, step + 1e-11), START_NS)) == "speed"


@each_kind
@pytest.mark.parametrize(
    ("used", "after_ms", "more"),
    [
        (1.0, 8, 0.0),  # of a step, and what time refills
        (0.5, 8, 0.5),
        (0.5, -8, 0.5),  # a clock that goes back gives nothing, and takes nothing
        (1.0, 60, 0.0),
    ],
)
def test_time_refills_what_a_stream_has_used(
    kind: int, used: float, after_ms: int, more: float
) -> None:
    """By 1.25 times the speed, from when it was used."""
    step = STEPS[kind]
    travel = more * step + 1.25 * SPEEDS[kind] * max(0, after_ms) * 1e-3
    for share, rule in ((1.0 - LITTLE, ""), (1.0 + LITTLE, "speed")):
        monitor, first = begun(kind, **ROUND), used * step * (1.0 - 1e-12)
        assert monitor.check(displaced(kind, first), START_NS + 300 * MS) is None
        at_ns = START_NS + (300 + after_ms) * MS
        assert code(monitor.check(displaced(kind, first + share * travel), at_ns)) == rule


@each_kind
def test_however_long_a_stream_rests_it_gets_one_step(kind: int) -> None:
    """In one set point or in several at once."""
    step = STEPS[kind]
    for shares, rule in (((1.0 - LITTLE,), ""), ((1.0 + LITTLE,), "speed"),
                         ((0.5, 0.5 - LITTLE), ""), ((0.5, 0.5 + LITTLE), "speed")):  # fmt: skip
        monitor, at, trip = begun(kind, **ROUND), 0.0, None
        assert monitor.check(displaced(kind, 0.0), START_NS) is None
        for share in shares:
            assert trip is None
            at += share * step
            trip = monitor.check(displaced(kind, at), START_NS + 5000 * MS)
        assert code(trip) == rule


# --- any quarter of a second ----------------------------------------------------------------------


@each_kind
def test_in_any_250_ms_no_more_is_gone_than_the_speed_gives(kind: int) -> None:
    """A quarter above it; the trip gives both numbers. 250 ms later all of it is free again."""
    most = WINDOW * SPEEDS[kind]
    for share, rule in ((1.0 - LITTLE, ""), (1.0 + LITTLE, "rate")):
        monitor = begun(kind, **WIDE, **ROUND)
        trip = monitor.check(displaced(kind, share * most), START_NS + 100 * MS)
        assert code(trip) == rule
        assert trip is None or trip.value == pytest.approx(share * most)
        assert trip is None or trip.limit == pytest.approx(most)
    for after_ns, rule in ((250 * MS - 1, "rate"), (250 * MS, "")):
        monitor, first = begun(kind, **WIDE, **ROUND), 0.9 * most
        assert monitor.check(displaced(kind, first), START_NS) is None
        trip = monitor.check(displaced(kind, first + 0.9 * most), START_NS + after_ns)
        assert code(trip) == rule


@pytest.mark.parametrize(
    ("kind", "above"),
    [
        (0, nextafter(WINDOW * SPEEDS[0], 1.0)),
        (1, WINDOW * SPEEDS[1] * (1.0 + 1e-15)),  # the next number comes back as a smaller turn
    ],
)
def test_the_travel_of_a_window_may_be_used_to_the_last_digit(kind: int, above: float) -> None:
    """In numbers that are exact."""
    monitor = begun(kind, **WIDE, **ROUND)
    assert code(monitor.check(displaced(kind, above), START_NS + 4 * MS)) == "rate"
    assert monitor.check(displaced(kind, WINDOW * SPEEDS[kind]), START_NS + 4 * MS) is None


# --- from one 60 ms to the next -------------------------------------------------------------------

Moves = list[tuple[int, float]]  # when [ms], and where, in parts of what may come suddenly
MOTIONS: dict[str, Callable[[float], Moves]] = {
    "from rest": lambda s: [(4, s)],
    "from rest, in parts": lambda s: [(4, 0.3), (30, 0.7), (63, s)],
    "faster": lambda s: [(60, 0.9), (120, 1.8 + s)],
    "slower": lambda s: [(60, 0.9), (120, 1.8 - s)],
    "faster later": lambda s: [(60, 0.9), (120, 1.8), (180, 2.7 + s)],
    "slower later": lambda s: [(60, 0.9), (120, 1.8), (180, 2.7 - s)],
    "faster soon": lambda s: [(10, 0.4), (30, 0.9), (100, 1.8 + s)],
    "slower soon": lambda s: [(10, 0.4), (30, 0.9), (100, 1.8 - s)],
    "to and fro": lambda s: [(20, 0.5), (40, 1.0 - s)],
    "to and fro in parts": lambda s: [(4, 0.3), (34, 0.0), (63, s - 0.6)],
    "to and fro again": lambda s: [(10, 0.4), (30, 0.0), (80, 0.9), (100, 1.0 - s)],
    "to and fro long ago": lambda s: [(10, 0.4), (20, 0.0), (120, 0.5), (140, 1.0 - s)],
}


@each_kind
@pytest.mark.parametrize("motion", MOTIONS)
def test_from_one_60_ms_to_the_next_motion_changes_by_the_acceleration_at_most(
    kind: int, motion: str
) -> None:
    """Half as much again, and 20 ms at full speed: exactly; to and fro is a change as well."""
    for share, rule in ((1.0 - LITTLE, ""), (1.0 + LITTLE, "acceleration")):
        monitor, trip = begun(kind, **WIDE), None
        for at_ms, place in MOTIONS[motion](share):
            assert trip is None
            trip = monitor.check(displaced(kind, place * SUDDEN[kind]), START_NS + at_ms * MS)
        assert code(trip) == rule
        if trip is not None:
            assert trip.value == pytest.approx(SUDDEN[kind] / 0.06**2)
            assert trip.limit == ACCELS[kind]


def test_motion_may_change_by_the_acceleration_to_the_last_digit() -> None:
    """From rest, in numbers that are exact."""
    most_m, at_ns = SUDDEN[0], START_NS + 4 * MS
    trip = begun(0, **WIDE).check(displaced(0, nextafter(most_m, 1.0)), at_ns)
    assert code(trip) == "acceleration"
    assert begun(0, **WIDE).check(displaced(0, most_m), at_ns) is None


# --- from one stream to the next ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("after_ns", "rule"), [(60 * MS, "speed"), (250 * MS - 1, "speed"), (250 * MS, "")]
)
@each_kind
def test_a_jump_back_to_the_measured_pose_counts_as_travel_for_250_ms(
    kind: int, after_ns: int, rule: str
) -> None:
    """Since the last set point, or new streams would bypass the limits."""
    monitor, set_ns = begun(kind), START_NS + 200 * MS
    assert monitor.check(displaced(kind, 0.001), set_ns) is None
    assert code(monitor.begin(displaced(kind, 0.5), set_ns + after_ns)) == rule


@each_kind
def test_where_something_else_has_moved_the_arm_a_stream_begins_at_rest(kind: int) -> None:
    """From another place it is no jump; what was used up stays used up."""
    monitor, used = begun(kind, **WIDE), 0.0
    for at_ms in range(4, 84, 4):
        used += 0.06 * SUDDEN[kind]
        assert monitor.check(displaced(kind, used), START_NS + at_ms * MS) is None
    monitor.moved_otherwise()
    assert code(monitor.check(displaced(kind, used), START_NS + 84 * MS)) == "no_stream"
    assert monitor.begin(displaced(kind, 0.5), START_NS + 88 * MS) is None
    travelled = 0.06 * SUDDEN[kind]
    assert monitor.check(displaced(kind, 0.5 + travelled), START_NS + 92 * MS) is None
    left = WINDOW * SPEEDS[kind] - used - travelled
    trip = monitor.check(displaced(kind, 0.5 + travelled + 1.001 * left), START_NS + 96 * MS)
    assert code(trip) == "rate"

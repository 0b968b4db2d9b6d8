"""Arming in a cell whose controller is too slow, or whose packet is too coarse, for the contact."""

from pathlib import Path
from typing import Any

import pytest

from common.config.cell import CellConfig
from common.config.load import load_cell
from control.measured_range import ROUNDING_MOST_N, SEGMENTS, segment_range
from forcemesh.messages import ArmPurpose, Trip
from services.arbiter.preflight import contact_trips
from tests.fakes.arbiter_world import World
from tests.fakes.bench import DEMO, cell_with

CELLS = sorted(DEMO.parent.glob("*.yaml"))
LONGEST_S = max(row.longest_s for row in SEGMENTS)


def over_tcp(segment_s: float = 0.03, **changes: Any) -> CellConfig:
    """Return the cell of the demo over TCP with other values, `section__name`."""
    other = {name.replace("__", "."): value for name, value in changes.items()}
    other |= {"gateway.least_segment_s": segment_s, "sim.as_least_segment_s": segment_s}
    return load_cell(DEMO.with_name("demo-tcp.yaml"), other)


def trip_of(cell: CellConfig) -> Trip:
    """Return the one reason why the contact of a cell is refused."""
    (trip,) = contact_trips(cell)
    return trip


@pytest.mark.parametrize("path", CELLS, ids=lambda path: path.stem)
def test_every_cell_file_of_the_project_has_a_contact_that_arming_accepts(path: Path) -> None:
    """Stiffness, approach, rounding and segments suit each other."""
    assert list(contact_trips(load_cell(path))) == []


@pytest.mark.parametrize("row", SEGMENTS)
def test_the_stiffest_measured_contact_is_accepted_and_a_stiffer_one_refused(row) -> None:
    """With the number of the table, for force feedback only."""
    approach_m_s = 0.9 * row.force_rate_N_s / row.stiffest_N_m
    common = {"robot__delay_s": 0.01, "force__approach_m_s": approach_m_s}
    stiffest = over_tcp(row.longest_s, contact__stiffness_N_m=row.stiffest_N_m, **common)
    assert list(contact_trips(stiffest)) == []
    cell = over_tcp(row.longest_s, contact__stiffness_N_m=1.05 * row.stiffest_N_m, **common)
    trip = trip_of(cell)
    assert (trip.code, trip.limit, trip.unit) == ("stiffness", row.stiffest_N_m, "N/m")
    assert f"{row.longest_s * 1e3:g} ms (gateway.least_segment_s)" in trip.text
    world = World(cell).make_ready()
    assert world.core.arm(world.inputs()).code == "stiffness"
    assert world.core.arm(world.inputs(), "jog").accepted


def test_longer_segments_than_all_measured_ones_are_refused() -> None:
    """Whatever the contact is."""
    trip = trip_of(over_tcp(LONGEST_S + 0.001, robot__delay_s=0.01))
    assert (trip.code, trip.limit, trip.unit) == ("stiffness", LONGEST_S, "s")


def test_an_approach_faster_than_measured_with_such_segments_is_refused() -> None:
    """A delay that is too short in the cell file would allow it by the formula."""
    row = segment_range(0.03)
    assert row is not None
    cell = over_tcp(robot__delay_s=0.01, force__approach_m_s=0.006)
    trip = trip_of(cell)
    limit_m_s = row.force_rate_N_s / cell.contact.stiffness_N_m
    assert (trip.code, trip.value, trip.limit) == ("approach_speed", 0.006, limit_m_s)


def test_readings_that_may_be_late_for_too_long_at_the_approach_speed_are_refused() -> None:
    """The approach of the trip is accepted with this deadline, a longer deadline is not."""
    late = {"deadlines__sensor_s": 0.5}
    trip = trip_of(cell_with(**late))
    assert (trip.code, trip.value) == ("approach_speed", 0.01)
    assert "readings are stale after 0.5 s (deadlines.sensor_s, or three periods)" in trip.text
    assert "reaches 107 N until they stop the arm; limits.force_N allows 60 N" in trip.text
    assert trip.limit is not None
    slower = {"force__approach_m_s": trip.limit * (1.0 - 1e-9)}
    assert list(contact_trips(cell_with(**late, **slower))) == []
    assert trip_of(cell_with(deadlines__sensor_s=0.501, **slower)).code == "approach_speed"
    world = World(cell_with(**late)).make_ready()
    assert world.core.arm(world.inputs()).code == "approach_speed"
    assert world.core.arm(world.inputs(), "jog").accepted


def test_a_packet_too_coarse_for_the_contact_is_refused_where_set_points_are_sent() -> None:
    """Half the diagonal of a cube of packet units, times the stiffness; with host pc only."""
    coarse = {"contact__stiffness_N_m": 1e5, "force__approach_m_s": 0.001}
    cell = over_tcp(gateway__position_per_mm=50, **coarse)
    trip = trip_of(cell)
    assert (trip.code, trip.limit, trip.unit) == ("stiffness", ROUNDING_MOST_N, "N")
    assert trip.value == pytest.approx(1e5 * 3**0.5 / 2.0 * 20e-6)
    assert "gateway.position_per_mm" in trip.text
    there = over_tcp(gateway__position_per_mm=50, robot__hosts=["controller"], **coarse)
    assert list(contact_trips(there)) == []


STIFF = {"contact__stiffness_N_m": 9e4, "force__approach_m_s": 0.001}


@pytest.mark.parametrize(
    ("changes", "purpose", "warns"),
    [(STIFF, "all", True), (STIFF, "jog", False), ({}, "all", False)],
)
def test_arming_warns_with_the_number_and_is_not_refused(
    changes: dict[str, float], purpose: ArmPurpose, warns: bool
) -> None:
    """Only arming for force; a cell within its limits has no remark."""
    world = World(cell_with(**changes)).make_ready()
    reply = world.core.arm(world.inputs(), purpose)
    assert reply.accepted
    assert ("; forecast: at 20 mm/s across a slope of 10 degrees" in reply.text) == warns
    assert ("limits.force_N is 60 N" in reply.text) == warns

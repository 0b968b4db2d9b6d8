"""A restarted arbiter, whose status names the restart; a robot that has ended its lease."""

import pytest

from forcemesh.faults import tripped
from forcemesh.messages import Accepted, Trip
from services.arbiter.core import Arbiter
from tests.fakes.arbiter_world import DEADLINE_S, World


def test_a_new_arbiter_reports_that_another_one_commanded_before():
    """After kill and restart the status names the restart until the next arming."""
    world = World()
    world.change(
        "robot",
        accepted=Accepted(epoch=7, seq=90, at_ns=1),
        hold=tripped("robot_holds", "not armed"),
    )
    world.make_ready()
    assert [trip.code for trip in world.core.status().trips] == ["writer"]
    world.change("robot", hold=None)
    assert world.core.arm(world.inputs()).accepted
    assert world.core.status().trips == ()


def test_the_first_arbiter_of_a_robot_reports_no_restart():
    """Without an earlier accepted command nothing was interrupted."""
    assert World().make_ready().core.status().trips == ()


def test_an_arbiter_that_continues_earlier_leases_is_no_restart():
    """In a replay: the next lease and ownership number follow those of before."""
    world = World()
    world.core = Arbiter(world.cell, command_deadline_s=DEADLINE_S, numbers=(3, 8))
    world.change("robot", accepted=Accepted(epoch=7, seq=90, at_ns=1, ownership=8))
    status = world.make_ready().core.status()
    assert (status.trips, status.lease, status.ownership) == ((), 3, 8)
    assert world.core.arm(world.inputs()).accepted
    status = world.core.status()
    assert (status.lease, status.ownership) == (4, 9)


def test_a_process_begins_without_a_lease():
    """Only a replay gives other numbers."""
    status = World().core.status()
    assert (status.lease, status.ownership) == (0, 0)


@pytest.mark.parametrize(
    ("hold", "code"),
    [
        (None, "robot_holds"),
        (tripped("tracking", "HOLD on the pendant"), "tracking"),
        (tripped("no_lease", "of another start"), "robot_holds"),
    ],
)
def test_a_robot_with_another_challenge_has_ended_the_lease(hold: Trip | None, code: str):
    """At once, while one that still holds has time to answer; the robot's own cause is named."""
    world = World().make_ready()
    assert world.core.arm(world.inputs()).accepted
    world.change("robot", hold=hold)
    assert world.tick().permission is not None
    world.change("robot", challenge=1)
    assert world.tick().permission is None
    assert (world.core.state, world.core.status().trips[-1].code) == ("HOLDING", code)

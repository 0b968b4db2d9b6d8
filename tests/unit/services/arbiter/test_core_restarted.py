"""A restarted arbiter: its status names the restart as the cause of the hold."""

from forcemesh.faults import tripped
from forcemesh.messages import Accepted
from tests.fakes.arbiter_world import World


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

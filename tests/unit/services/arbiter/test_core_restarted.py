"""A new arbiter says why the arm holds, although it has seen nothing of it."""

from forcemesh.faults import tripped
from forcemesh.messages import Accepted
from tests.fakes.arbiter_world import World


def test_a_new_arbiter_says_that_another_one_commanded_before():
    """After kill and restart its status is not empty: it names the restart, until a person arms."""
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


def test_the_first_arbiter_of_a_robot_says_nothing():
    """Where no command was ever accepted nothing was interrupted."""
    assert World().make_ready().core.status().trips == ()

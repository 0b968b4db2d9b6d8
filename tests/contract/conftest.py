"""The robots of the contract as fixtures: all of them, or those with a property of the table."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import pytest

from tests.contract.rig import Rig
from tests.contract.robots import ROBOTS, Robot


def those(has: Callable[[Robot], bool]) -> list[str]:
    """Return the names of the robots with a property."""
    return [name for name, robot in ROBOTS.items() if has(robot)]


@contextmanager
def made(name: str) -> Iterator[Rig]:
    """A robot that says where it is."""
    with ExitStack() as stack:
        robot = ROBOTS[name]
        rig = robot.make(stack)
        rig.connect()
        robot.before(rig)
        yield rig


@pytest.fixture(params=those(lambda robot: True))
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """Every robot."""
    with made(request.param) as rig:
        yield rig


@pytest.fixture(params=those(lambda robot: robot.feedback_host == "controller"))
def controller_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The robots whose controller runs force feedback, so that they read the wrench."""
    with made(request.param) as rig:
        yield rig


@pytest.fixture(params=those(lambda robot: robot.guards_limits))
def guarded_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The robots that keep the cell's limits again."""
    with made(request.param) as rig:
        yield rig


@pytest.fixture(params=those(lambda robot: not robot.has_controller))
def bare_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The robots without a controller that could run force feedback."""
    with made(request.param) as rig:
        yield rig

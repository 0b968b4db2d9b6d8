"""Fixtures of the contract's robots: all of them, or those with a property of the table."""

from collections.abc import Callable

import pytest

from tests.contract.rig import Rig
from tests.contract.robots import ALL, ROBOTS, Robot


def those(has: Callable[[Robot], bool]) -> list[str]:
    """Return the names of the robots with a property."""
    return [name for name, robot in ROBOTS.items() if has(robot)]


def made(name: str) -> Rig:
    """Return a robot that has reported its pose."""
    robot = ALL[name]
    rig = robot.make()
    rig.connect()
    robot.before(rig)
    return rig


@pytest.fixture(params=those(lambda robot: True))
def rig(request: pytest.FixtureRequest) -> Rig:
    """Every robot."""
    return made(request.param)


@pytest.fixture(params=those(lambda robot: robot.feedback_host == "controller"))
def controller_rig(request: pytest.FixtureRequest) -> Rig:
    """The robots whose controller runs force feedback and therefore reads the wrench."""
    return made(request.param)


@pytest.fixture(params=those(lambda robot: robot.guards_limits))
def guarded_rig(request: pytest.FixtureRequest) -> Rig:
    """The robots that check the limits of the cell a second time."""
    return made(request.param)


@pytest.fixture(params=those(lambda robot: not robot.has_controller))
def bare_rig(request: pytest.FixtureRequest) -> Rig:
    """The robots whose controller cannot run force feedback."""
    return made(request.param)

"""Both readings of the manual that the program must bear."""

import pytest

from sim.controller.behaviour import Behaviour, pessimistic
from tests.fakes.controller import QUICK

BEHAVIOURS = {"kind": Behaviour(step_s=QUICK.step_s), "pessimistic": pessimistic(QUICK.step_s)}


@pytest.fixture(params=list(BEHAVIOURS))
def behaviour(request: pytest.FixtureRequest) -> Behaviour:
    """The kind reading of the open questions, and the worse one."""
    return BEHAVIOURS[request.param]

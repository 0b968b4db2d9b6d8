"""The reply to `arm` warns where the forecast for the cell's own press breaks a limit."""

import pytest

from forcemesh.messages import ArmPurpose
from tests.fakes.arbiter_world import World
from tests.fakes.bench import cell_with

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

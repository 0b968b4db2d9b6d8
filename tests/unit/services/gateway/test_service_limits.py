"""Limits of the controller and of the gateway, and the end after a refusal."""

import numpy as np
import pinocchio as pin
import pytest

from controller.packet_table import Com, Status
from services.gateway.service import controller_limits, set_point_step
from tests.contract.rig import gateway_cell
from tests.fakes.gateway_world import GatewayWorld

CELL = gateway_cell(49152)


def streaming() -> GatewayWorld:
    """Return a stream of set points at the arm's pose."""
    world = GatewayWorld()
    world.lease += 1
    for _ in range(20):
        world.send(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
        world.live(10)
    assert (Com.SET_POINT, 0) in world.controller.notes
    assert (Com.MOVE_POSE, 0) not in world.controller.notes
    return world


def test_a_set_point_that_the_controller_refuses_ends_in_hold() -> None:
    """The arm is still at the set point before; the stream does not continue."""
    world = streaming()
    world.codes.clear()
    world.controller.on = Status.TARGET_REFUSED
    for _ in range(5):
        world.send(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
        world.live(10)
    assert "robot_refuses" in world.codes
    assert world.controller.notes[-1] == (Com.HOLD, 0)


def test_a_stream_does_not_begin_far_from_the_last_set_point_sent() -> None:
    """What was sent may be behind what was commanded: the first one can only go out unchanged."""
    world, T = GatewayWorld(), pin.SE3.Identity()
    world.gateway.driver._shaper.last = T
    world.lease += 1
    for _ in range(5):
        world.send(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
        world.live(10)
    assert "acceleration" in world.codes
    assert (Com.SET_POINT, 0) not in world.controller.notes


def test_a_new_lease_begins_with_a_hold_of_the_controller() -> None:
    """The controller counts turns from a hold, the gateway from the lease: both start together."""
    world = streaming()
    holds = world.controller.notes.count((Com.HOLD, 0))
    for _ in range(3):
        world.lease += 1
        for _ in range(5):
            world.send(world.permitted("idle"))
            world.live(10)
    assert world.controller.notes.count((Com.HOLD, 0)) == holds + 3


def test_limits_of_the_controller_are_slightly_wider_than_the_gateways() -> None:
    """Rounding is never refused, and the gateway reports a violation first."""
    assert CELL.gateway is not None
    kept = controller_limits(CELL, CELL.gateway)
    step_m, step_rad = set_point_step(CELL, CELL.gateway)
    limits = CELL.limits
    assert kept.speed_m_s == CELL.force.speed_max_m_s < limits.speed_m_s  # of force feedback
    assert step_m <= limits.step_m
    assert step_rad <= np.radians(limits.step_deg)
    assert step_m < kept.set_point_m < 1.2 * step_m
    assert step_rad < kept.set_point_rad < 1.2 * step_rad
    assert 0.0 < kept.turn_rad - np.radians(limits.tether_deg) < np.radians(1.0)
    assert limits.speed_m_s < kept.fastest_m_s < 1.05 * limits.speed_m_s
    for low, high in zip(kept.lower_m, limits.workspace_min_m, strict=True):
        assert 0.002 < high - low < 0.004
    for low, high in zip(limits.workspace_max_m, kept.upper_m, strict=True):
        assert 0.002 < high - low < 0.004


@pytest.mark.parametrize("segment_s", [0.02, 0.05, 1.0])
def test_the_step_is_the_travel_of_one_segment_and_at_most_limits_step(
    segment_s: float,
) -> None:
    """The step is `gateway.segment_s` times the speed, for translation and rotation."""
    cell = gateway_cell(49152, **{"gateway.segment_s": segment_s})
    assert cell.gateway is not None
    step_m, step_rad = set_point_step(cell, cell.gateway)
    assert step_m == pytest.approx(min(cell.limits.step_m, cell.limits.speed_m_s * segment_s))
    turn_deg = min(cell.limits.step_deg, cell.limits.speed_deg_s * segment_s)
    assert np.degrees(step_rad) == pytest.approx(turn_deg)

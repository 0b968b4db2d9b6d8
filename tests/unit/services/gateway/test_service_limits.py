"""Limits of the controller and of the gateway, and the end after a refusal."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.packet_table import Com, Status
from forcemesh.clock import NS_PER_S
from services.gateway.service import controller_limits, set_point_step
from services.gateway.setpoint_shaper import SetpointShaper
from tests.contract.rig import gateway_cell
from tests.fakes.gateway_world import FaultyController, GatewayWorld

CELL = gateway_cell(49152)
PERIOD_NS = 16_000_000


class CommandRecorder(FaultyController):
    """A controller that records the command of every packet."""

    def __init__(self) -> None:
        super().__init__()
        self.coms: list[int] = []

    def send(self, data: bytes, now_ns: int) -> bool:
        """Take packets and record them."""
        self.coms += [int(data[at + 7 : at + 13]) for at in range(0, len(data), 63)]
        return super().send(data, now_ns)


def streaming() -> tuple[GatewayWorld, CommandRecorder]:
    """Return a stream of set points at the arm's pose."""
    controller = CommandRecorder()
    world = GatewayWorld(controller)
    world.lease += 1
    for _ in range(20):
        world.send(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
        world.live(10)
    assert Com.SET_POINT in controller.coms
    assert Com.MOVE_POSE not in controller.coms
    return world, controller


def test_a_set_point_that_the_controller_refuses_ends_in_hold() -> None:
    """The arm is still at the set point before; the stream does not continue."""
    world, controller = streaming()
    world.codes.clear()
    controller.on = Status.TARGET_REFUSED
    for _ in range(5):
        world.send(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
        world.live(10)
    assert "robot_refuses" in world.codes
    assert controller.coms[-1] == Com.HOLD


def test_a_new_lease_begins_with_a_hold_of_the_controller() -> None:
    """The controller counts turns from a hold, the gateway from the lease: both start together."""
    world, controller = streaming()
    holds = controller.coms.count(Com.HOLD)
    for _ in range(3):
        world.lease += 1
        for _ in range(5):
            world.send(world.permitted("idle"))
            world.live(10)
    assert controller.coms.count(Com.HOLD) == holds + 3


def test_limits_of_the_controller_are_slightly_wider_than_the_gateways() -> None:
    """Rounding is never refused, and the gateway reports a violation first."""
    assert CELL.gateway is not None
    kept = controller_limits(CELL, CELL.gateway)
    step_m, step_rad = set_point_step(CELL, CELL.gateway)
    limits = CELL.limits
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


@given(
    travel_m=st.floats(-0.05, 0.05), turn_rad=st.floats(-0.5, 0.5), step_m=st.floats(1e-3, 2e-2)
)  # fmt: skip
def test_no_set_point_is_farther_from_the_one_before_than_a_step(
    travel_m: float, turn_rad: float, step_m: float
) -> None:
    """Any target is sent in steps, and completely."""
    step_rad = 4.0 * step_m
    shaper = SetpointShaper(CELL.limits, lambda _: None, step=(step_m, step_rad))
    begin = pin.SE3.Identity()
    target = pin.SE3(pin.utils.rotate("x", turn_rad), np.array([travel_m, 0.0, 0.0]))
    now_ns, before = NS_PER_S, begin
    assert shaper.seed(begin, now_ns) is None
    shaper.release(begin, now_ns)
    for _ in range(400):
        now_ns += PERIOD_NS
        sent = shaper.release(target, now_ns)
        if sent is None:
            continue
        step = before.actInv(sent)
        assert np.linalg.norm(step.translation) < step_m * (1.0 + 1e-6) + 1e-12
        assert np.linalg.norm(pin.log3(step.rotation)) < step_rad * (1.0 + 1e-6) + 1e-7
        before = sent
        if sent is target:
            break
    assert np.allclose(before.homogeneous, target.homogeneous, atol=1e-9)

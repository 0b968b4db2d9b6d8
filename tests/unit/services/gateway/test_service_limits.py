"""What the gateway tells the controller to keep, keeps itself, and does when that is refused."""

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
from tests.fakes.gateway_world import GatewayWorld, MoodyController

CELL = gateway_cell(49152)
PERIOD_NS = 16_000_000


class NotingController(MoodyController):
    """Keeps the command of every packet for the test."""

    def __init__(self) -> None:
        super().__init__()
        self.coms: list[int] = []

    def send(self, data: bytes, now_ns: int) -> bool:
        """Take packets, and note them."""
        self.coms += [int(data[at + 7 : at + 13]) for at in range(0, len(data), 63)]
        return super().send(data, now_ns)


def streaming() -> tuple[GatewayWorld, NotingController]:
    """A stream of set points that stands where the arm is."""
    controller = NotingController()
    world = GatewayWorld(controller)
    world.lease += 1
    for _ in range(20):
        world.say(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
        world.live(10)
    assert Com.SET_POINT in controller.coms
    assert Com.MOVE_POSE not in controller.coms
    return world, controller


def test_a_set_point_that_the_controller_refuses_ends_in_hold() -> None:
    """The arm stands at the one before; nothing goes on as if it had moved."""
    world, controller = streaming()
    world.codes.clear()
    controller.on = Status.TARGET_REFUSED
    for _ in range(5):
        world.say(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
        world.live(10)
    assert "robot_refuses" in world.codes
    assert controller.coms[-1] == Com.HOLD


def test_a_new_lease_begins_with_a_hold_of_the_controllers_own() -> None:
    """It counts turns from a hold, the gateway from the lease: both from the same place."""
    world, controller = streaming()
    holds = controller.coms.count(Com.HOLD)
    for _ in range(3):
        world.lease += 1
        for _ in range(5):
            world.say(world.permitted("idle"))
            world.live(10)
    assert controller.coms.count(Com.HOLD) == holds + 3


def test_what_the_controller_keeps_is_a_little_wider_than_what_leaves_here() -> None:
    """So that rounding is never refused, and this process says first what was wrong."""
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
def test_the_step_is_what_the_arm_goes_in_a_segment_and_no_more_than_limits_step(
    segment_s: float,
) -> None:
    """`gateway.segment_s` times the speed, in both kinds."""
    cell = gateway_cell(49152, **{"gateway.segment_s": segment_s})
    assert cell.gateway is not None
    step_m, step_rad = set_point_step(cell, cell.gateway)
    assert step_m == pytest.approx(min(cell.limits.step_m, cell.limits.speed_m_s * segment_s))
    turn_deg = min(cell.limits.step_deg, cell.limits.speed_deg_s * segment_s)
    assert np.degrees(step_rad) == pytest.approx(turn_deg)


@given(
    way_m=st.floats(-0.05, 0.05), turn_rad=st.floats(-0.5, 0.5), step_m=st.floats(1e-3, 2e-2)
)  # fmt: skip
def test_no_set_point_is_farther_from_the_one_before_than_a_step(
    way_m: float, turn_rad: float, step_m: float
) -> None:
    """Whatever is wanted leaves in steps, and all of it leaves."""
    step_rad = 4.0 * step_m
    departures = SetpointShaper(CELL.limits, lambda _: None, step=(step_m, step_rad))
    begin = pin.SE3.Identity()
    wanted = pin.SE3(pin.utils.rotate("x", turn_rad), np.array([way_m, 0.0, 0.0]))
    now_ns, before = NS_PER_S, begin
    assert departures.seed(begin, now_ns) is None
    departures.leave(begin, now_ns)
    for _ in range(400):
        now_ns += PERIOD_NS
        left = departures.leave(wanted, now_ns)
        if left is None:
            continue
        step = before.actInv(left)
        assert np.linalg.norm(step.translation) < step_m * (1.0 + 1e-6) + 1e-12
        assert np.linalg.norm(pin.log3(step.rotation)) < step_rad * (1.0 + 1e-6) + 1e-7
        before = left
        if left is wanted:
            break
    assert np.allclose(before.homogeneous, wanted.homogeneous, atol=1e-9)

"""Faults of the controller while a command is permitted, on the virtual clock.

tests/fakes/gateway_world.py checks each packet.
"""

import pytest

from common.motion.convert import record_of
from controller.packet_table import Status
from tests.fakes.gateway_world import FaultyController, GatewayWorld


@pytest.mark.parametrize(
    ("on", "off", "code"),
    [
        (Status(0), Status.MOTOR_POWER, "robot_motors"),
        (Status(0), Status.REPEAT_MODE, "robot_teach"),
        (Status(0), Status.PROGRAM_RUNNING, "robot_program"),
        (Status.ERROR, Status(0), "robot_error"),
    ],
)
def test_a_fault_of_the_controller_ends_the_lease_for_good(
    on: Status, off: Status, code: str
) -> None:
    """Its code is the reason; permitted commands move nothing once the bit is good again."""
    controller = FaultyController()
    world = GatewayWorld(controller)
    world.lease += 1

    def stream() -> None:
        world.send(world.permitted("setpoint", pose=record_of(world.T)))
        world.live(10)

    stream()
    assert world.gateway.verdict.command is not None
    controller.on, controller.off = on, off
    stream()
    assert world.gateway.verdict.command is None
    assert world.gateway.verdict.hold_code == code
    controller.on = controller.off = Status(0)
    stream()
    assert world.gateway.verdict.command is None
    assert code in world.codes

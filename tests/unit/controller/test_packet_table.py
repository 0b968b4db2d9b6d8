"""Numbers of the packet: both ends have them, so a table here cannot change alone."""

import pytest

from controller.packet_table import (
    COMMANDS,
    GAIN_I,
    GAIN_P,
    ID_COUNT,
    ID_FIRST,
    ID_LAST,
    TABLE,
    Com,
    Scales,
    Status,
)
from forcemesh.errors import ConfigError
from forcemesh.yaml_file import validated

# controller/forcemesh.as and the programs of others compare with these.
NUMBERS = {
    "MOVE_POSE": 1, "MOVE_JOINTS": 2, "MOVE_BY_JOINTS": 3, "WRENCH": 4, "SPEEDS": 5, "GAINS": 6,
    "FEEDBACK": 7, "HOLD": 8, "HELLO": 9, "LIMITS": 10, "TCP": 11, "HEARTBEAT": 12, "SET_POINT": 13,
    "FORCE_SET_POINT": 14, "SIGNAL": 15, "POSE": 101, "JOINTS": 102, "HEALTH": 103, "SIGNALS": 104,
}  # fmt: skip
STATUS = (
    "MOTOR_POWER", "REPEAT_MODE", "TEACH_LOCK_OFF", "PROGRAM_RUNNING", "MOVING",
    "POSITION_FEEDBACK", "ORIENTATION_FEEDBACK", "HELD", "WATCHDOG_LATCHED", "TARGET_REFUSED",
    "ERROR",
)  # fmt: skip
# Commands that the robot program takes from its ring: all of their Params, but for stop.
IN_RING = {1: 1, 2: 1, 3: 1, 5: 1, 6: 2, 7: 2, 10: 6, 11: 2, 13: 1}


def test_the_numbers_of_commands_status_bits_ids_and_gains() -> None:
    """As in the specification (1.4) and in the program of the controller."""
    assert {com.name: com.value for com in Com} == NUMBERS
    assert {bit.name: bit.value for bit in Status} == {b: 1 << k for k, b in enumerate(STATUS)}
    assert (ID_FIRST, ID_LAST, ID_COUNT) == (500_000, 999_999, 500_000)
    assert (GAIN_P, GAIN_I) == (500_000, 5_000)


@pytest.mark.parametrize("com", sorted(COMMANDS))
def test_what_the_robot_program_executes_and_reports_as_taken(com: Com) -> None:
    """The receiver executes the others at once; the gateway waits only for these."""
    assert TABLE[com].ring == range(IN_RING.get(com, 0))


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("position_per_mm", 10, 99), ("oat_per_deg", 100, 555), ("joint_per_deg", 50, 277),
        ("force_per_N", 1, 999), ("torque_per_Nm", 10, 9999), ("speed_per_mm_s", 1, 1000),
    ],
)  # fmt: skip
def test_the_bounds_of_the_scales(name: str, least: int, most: int) -> None:
    """The controller refuses others in its hello, so a cell file must not ask for them."""
    for value in (least, most):
        assert getattr(validated(Scales, {name: value}, "scales"), name) == value
    for value in (least - 1, most + 1):
        with pytest.raises(ConfigError, match=name):
            validated(Scales, {name: value}, "scales")

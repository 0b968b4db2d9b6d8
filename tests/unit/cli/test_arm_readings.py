"""Force, pose and calibration in `forcemesh status`, and the lines that replace missing data."""

import pytest

from cli.arm_readings import ArmView, no_readings, reading_lines
from common.bus.memory_bus import MemoryTransport
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.messages import Health, Message, RegulatorTarget, RobotState, WrenchAtTcp
from forcemesh.topics import Topic
from tests.fakes.bench import DEMO

CELL = load_cell(DEMO)
DOWN = (1.0, 0.0, 0.0, 0.0)  # the tool's z axis points down
ROBOT = RobotState(position_m=(0.45, -0.1, 0.3), orientation_xyzw=DOWN, joint_rad=(0.0,) * 6)
WRENCH = WrenchAtTcp(
    force_N=(0.0, -0.001, 12.0), calibration="rev", tared=True, calibrated=True, axes_checked=True
)
TARGET = RegulatorTarget(setpoint_N=12.0, contact="contact")


class Cell:
    """The bus of a cell on a clock that a test advances."""

    def __init__(self, *messages: tuple[Topic, Message]) -> None:
        """Publish messages, each as the role that writes its topic."""
        self.clock, transport = ManualClock(), MemoryTransport()
        self.view = ArmView(Bus("client", CELL.cell, transport, CELL, self.clock), CELL)
        for topic, message in messages:
            bus = Bus(topic.writer, CELL.cell, transport, CELL, self.clock)
            bus.publisher(topic).put(message)

    def lines(self, health: Health | None = None) -> dict[str, str]:
        """Return the lines that a user reads."""
        return dict(reading_lines(self.view.readings(health)))


@pytest.fixture
def cell() -> Cell:
    """A cell whose arm presses downwards with 12 N."""
    robot, target = (topics.ROBOT_STATE, ROBOT), (topics.REGULATOR_TARGET, TARGET)
    return Cell(robot, (topics.WRENCH, WRENCH), target)


def test_force_pose_and_calibration_are_shown_with_their_units(cell: Cell) -> None:
    """The press force is that along the tool's axis; a zero has no sign."""
    lines = cell.lines(Health(numbers={"tare_age_h": 0.05}))
    assert lines == {
        "force": "press force 12.00 N, set point 12 N (in contact), (0.00, 0.00, 12.00) N, "
        "(0.000, 0.000, 0.000) N m in base axes",
        "pose": "flange at 450.0, -100.0, 300.0 mm, O A T 0.0, 180.0, 180.0 degrees",
        "calibration": "rev, tared, bias 3 min old, axes checked",
    }
    assert cell.view.is_complete()
    found = cell.view.readings(None)  # for programs: in SI, as on the bus
    assert found["force"]["press_N"] == pytest.approx(12.0)
    assert found["pose"]["position_m"] == (0.45, -0.1, 0.3)


def test_missing_and_stale_data_is_named_and_never_a_number(cell: Cell) -> None:
    """A force without a measurement is not shown as zero; without a pose it is in base axes."""
    cell.clock.sleep_s(2.0 * CELL.stale_after_s(topics.ROBOT_STATE))
    for line in cell.lines().values():
        assert line.startswith("no data: ")
        assert "stale" in line
    silent = Cell()
    assert silent.lines()["force"] == silent.lines()["calibration"] == "no data: wrench missing"
    assert silent.lines()["pose"] == "no data: robot/state missing"
    assert not silent.view.is_complete()
    assert {text for _, text in reading_lines(no_readings())} == {"no data: no hub responds"}
    unusable = WRENCH.replaced(
        calibrated=False, axes_checked=False, calibration_fault="no calibration"
    )
    lines = Cell((topics.WRENCH, unusable)).lines(Health(numbers={"tare_age_h": 30.25}))
    assert lines["force"].startswith("(0.00, 0.00, 12.00) N")
    assert lines["calibration"] == (
        "rev, tared, bias 30.2 h old, axes not checked, not for force feedback: no calibration"
    )

"""Commands of a life that is over: a played recording, and a lease that has just ended."""

from pathlib import Path

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.codec import decode
from forcemesh.messages import RobotCommand
from forcemesh.requests import Empty, HoldRequest
from launch.virtual_cell import VirtualCell, WorldClock
from services.recorder.reading import RecordedBytes, RecordedFile, play
from tests.fakes.bench import DEMO
from tests.fakes.lab import Lab
from tests.fakes.recorded_cell import recorded

ROBOT_ALONE = ("hub", "wrench", "regulator", "arbiter")
STILL_RAD = 1e-9  # of commanded joints
CONNECTED_S = 1.6  # a controller's hello and its first reports


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> list[RecordedBytes]:
    """Every message of a cell that is armed, moves and presses, twice."""
    path = recorded(tmp_path_factory.mktemp("recording"))
    messages = list(RecordedFile(path).raw_messages())
    commands = [each.data for each in messages if each.topic == topics.ROBOT_COMMAND.key]
    kinds = {c.kind for _, c in (decode(data, RobotCommand) for data in commands) if c.permission}
    assert kinds == {"idle", "goal", "setpoint"}
    return messages


def played(world: VirtualCell, recording: list[RecordedBytes]) -> set[str]:
    """Play a recording; return the codes of the robot's holds. The commanded joints stay."""
    world.clock.boot = "another boot"  # the age of a recorded message counts from its receipt
    robot = world.runners["robot"].service
    start, codes = world.arm.q_command.copy(), set[str]()

    def shown(_count: int, _at_s: float) -> None:
        assert np.abs(world.arm.q_command - start).max() <= STILL_RAD
        codes.add(robot.verdict.hold_code)  # type: ignore[attr-defined]

    play(recording, world.transport, world.cell.cell, clock=WorldClock(world), shown=shown)
    return codes


@pytest.mark.parametrize("file", ["demo.yaml", "demo-tcp.yaml"])
def test_a_robot_that_has_known_no_arbiter_executes_no_recorded_command(
    file: str, recording: list[RecordedBytes]
) -> None:
    """Simulated robot and gateway refuse every permission: it is of a life that is over."""
    world = VirtualCell(load_cell(Path(DEMO).with_name(file), {"cell": "demo"}))
    for role in ROBOT_ALONE:
        world.kill(role)
    world.advance(CONNECTED_S)
    codes = played(world, recording)
    assert "no_lease" in codes
    assert "" not in codes  # it has executed nothing


def test_a_recording_played_into_an_armed_cell_moves_nothing(
    recording: list[RecordedBytes],
) -> None:
    """The arm holds, and at the end the present arbiter has ended its lease."""
    lab = Lab(load_cell(DEMO))
    codes = played(lab.cell, recording)
    assert codes & {"two_writers", "no_lease"}
    assert lab.cell.runners["arbiter"].service._core.state == "FAULT"  # type: ignore[attr-defined]


def test_arming_waits_for_a_slow_robot_to_report_the_end_of_the_last_lease() -> None:
    """At 15 Hz the report of a moment ago still has the old challenge; the next one has not."""
    lab = Lab(load_cell(DEMO, {"rates.robot_hz": 15.0}))
    lab.cell.advance(0.5)
    for _ in range(5):
        assert lab.ask(topics.HOLD, HoldRequest()).accepted
        lab.cell.advance(0.01)
        lab.seconds_until(lambda: lab.ask(topics.ARM, Empty()).accepted, 0.1)
        lab.cell.advance(0.5)
        assert lab.status.state == "ARMED"
        assert lab.state.hold is None

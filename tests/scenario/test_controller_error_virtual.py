"""An error of the robot program, as the controller reports it, from its code to every display."""

from pathlib import Path

import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.requests import ArmRequest, Empty
from launch.virtual_cell import VirtualCell
from sim.as_language.errors import AsError
from sim.controller.service import ControllerSensor

CELL = Path(__file__).resolve().parents[2] / "cells" / "demo-tcp.yaml"


@pytest.mark.parametrize(
    ("code", "text", "remedy"),
    [
        ("E1117", "E1117 Process time over", "gateway.least_segment_s"),
        ("E6007", "E6007 Position is out of the motion range", "by hand"),
        ("E1999", "E1999", "appendix 4"),
    ],
)
def test_an_error_of_the_program_is_shown_with_its_text_and_remedy(code, text, remedy):
    """The lease ends with the connection; the code that is read after it joins the fault's causes.

    A code that is not in our table is reported as such, never with a text of ours.
    """
    world = VirtualCell(load_cell(CELL, {"calibration": "none"}))
    status = world.client.reader(topics.ARBITER_STATUS)
    world.advance(3.0)
    assert world.client.ask(topics.TARE, Empty()).accepted
    world.advance(1.0)
    assert world.client.ask(topics.ARM, ArmRequest()).accepted
    world.advance(1.0)
    controller = world.runners["sensor"].service
    assert isinstance(controller, ControllerSensor)
    control = controller.machine.control
    control.failed(control.robot_task, AsError(code))
    world.advance(2.0)
    newest = status.read(world.clock.now_ns()).message
    assert newest is not None
    assert newest.state == "FAULT"
    (trip,) = [trip for trip in newest.trips if trip.code == "robot_error"]
    assert text in trip.text
    assert remedy in trip.text
    assert trip.value == -30_000 - int(code[1:])
    assert any(text in line for line in newest.not_ready)

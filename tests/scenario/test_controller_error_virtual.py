"""An error of the robot program, as the controller reports it, from its code to every display."""

import pytest

from common.config.load import load_cell
from sim.as_language.errors import AsError
from tests.fakes.bench import DEMO
from tests.fakes.lab import Lab

CELL = load_cell(DEMO.with_name("demo-tcp.yaml"))


@pytest.mark.parametrize(
    ("code", "text", "remedy"),
    [
        ("E1117", "E1117 Process time over", "gateway.least_segment_s"),
        ("E6007", "E6007 Position is out of the motion range", "by hand"),
        ("E1999", "E1999", "appendix 4"),
    ],
)
def test_an_error_of_the_program_is_shown_with_its_text_and_remedy(code, text, remedy) -> None:
    """The lease ends with the connection; the code that is read after it joins the fault's causes.

    A code that is not in our table is reported as such, never with a text of ours.
    """
    lab = Lab(CELL)
    control = lab.machine.control
    control.failed(control.robot_task, AsError(code))
    lab.cell.advance(2.0)
    assert lab.status.state == "FAULT"
    (trip,) = [trip for trip in lab.status.trips if trip.code == "robot_error"]
    assert text in trip.text
    assert remedy in trip.text
    assert trip.value == -30_000 - int(code[1:])
    assert any(text in line for line in lab.status.not_ready)

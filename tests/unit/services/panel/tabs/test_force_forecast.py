"""The line above the start button: the forecast of the entered press."""

import pytest

from forcemesh.requests import ForceStartRequest
from services.panel.tabs.force import forecast_line
from tests.fakes.bench import CELL


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (ForceStartRequest(setpoint_N=15.0, law="plain"), "forecast: settles 0."),
        (ForceStartRequest(setpoint_N=15.0, law="adaptive"), "follows 20 mm/s across 10 degrees"),
        (ForceStartRequest(setpoint_N=2.0), "no forecast: set point is 2 N"),
        (ForceStartRequest(setpoint_N=15.0, mode="both"), "no forecast for mode both"),
        (ForceStartRequest(setpoint_N=15.0, host="controller"), "no forecast for host controller"),
        (ForceStartRequest(law="admittance"), "no forecast for law admittance"),
    ],
)
def test_the_line_follows_the_entries(request_: ForceStartRequest, text: str) -> None:
    """Set point, law, mode and host; otherwise why there is no forecast."""
    assert text in str(forecast_line(request_, CELL))

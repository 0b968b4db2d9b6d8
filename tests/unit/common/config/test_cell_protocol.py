"""Terms of protocol plain: lower limits, one host, and no change for any other cell."""

from pathlib import Path

import pytest

from common.config.load import load_cell
from controller.plain import MOST
from forcemesh.errors import ConfigError

CELLS = Path(__file__).resolve().parents[4] / "cells"
PLAIN = CELLS / "demo-plain.yaml"


@pytest.mark.parametrize("field", MOST)
def test_each_limit_has_a_lower_bound_of_its_own(field: str) -> None:
    """The number and the limit; a risk assessment does not lift it; with our protocol it is off."""
    most, _ = MOST[field]
    load_cell(PLAIN, {field: most})
    changes = {field: 1.01 * most, "limits.risk_assessment": "assessed"}
    with pytest.raises(ConfigError, match=f"{field} is {1.01 * most:g}.*at most {most:g}"):
        load_cell(PLAIN, changes)
    load_cell(CELLS / "demo-tcp.yaml", {field: 1.01 * most, "force.setpoint_max_N": 20})


def test_the_loop_runs_in_the_controller_only() -> None:
    """Set points of a loop on the PC have no command."""
    for hosts in (["pc"], ["pc", "controller"], []):
        with pytest.raises(ConfigError, match=r"robot\.hosts must be \[controller\]"):
            load_cell(PLAIN, {"robot.hosts": hosts})

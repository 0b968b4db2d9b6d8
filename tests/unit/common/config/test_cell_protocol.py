"""Terms of protocol plain: lower limits, one host, and no change for any other cell."""

from pathlib import Path

import pytest

from common.config.load import load_cell
from controller.plain import MOST, PlainSection
from forcemesh.errors import ConfigError

CELLS = Path(__file__).resolve().parents[4] / "cells"
PLAIN = CELLS / "demo-plain.yaml"


@pytest.mark.parametrize(
    ("field", "most"),
    [(field, most) for field, (most, _) in MOST.items()],
)
def test_each_limit_has_a_lower_bound_of_its_own(field: str, most: float) -> None:
    """The number, the limit and the reason; a risk assessment does not lift it."""
    load_cell(PLAIN, {field: most})
    changes = {field: 1.01 * most, "limits.risk_assessment": "assessed"}
    with pytest.raises(ConfigError) as caught:
        load_cell(PLAIN, changes)
    assert f"{field} is {1.01 * most:g}" in str(caught.value)
    assert f"at most {most:g}" in str(caught.value)
    load_cell(CELLS / "demo-tcp.yaml", {field: 1.01 * most, "force.setpoint_max_N": 20})


@pytest.mark.parametrize("hosts", [["pc"], ["pc", "controller"], []])
def test_the_loop_runs_in_the_controller_only(hosts: list[str]) -> None:
    """Set points of a loop on the PC have no command."""
    with pytest.raises(ConfigError, match=r"robot\.hosts must be \[controller\]"):
        load_cell(PLAIN, {"robot.hosts": hosts})


def test_other_cells_are_not_concerned() -> None:
    """Without a gateway, or with our protocol, which is the default."""
    assert load_cell(CELLS / "demo.yaml").gateway is None
    tcp = load_cell(CELLS / "demo-tcp.yaml")
    assert tcp.gateway is not None
    assert (tcp.gateway.protocol, tcp.gateway.send_wrench) == ("forcemesh", False)
    assert tcp.gateway.plain == PlainSection()


@pytest.mark.parametrize(
    ("field", "value"),
    [("protocol", "telnet"), ("plain.packet_chars", 60), ("plain.position_per_mm", 0),
     ("plain.position_per_mm", 100), ("plain.scale", 1)],
)  # fmt: skip
def test_what_is_no_setting_of_it_is_refused(field: str, value: object) -> None:
    """Named with its place in the cell file."""
    with pytest.raises(ConfigError, match=rf"gateway\.{field}"):
        load_cell(PLAIN, {f"gateway.{field}": value})

"""Measured delay and monitor speed against the values that the gains rely on; age of the tare."""

from math import inf, nextafter
from typing import Any

import pytest

from common.config.load import load_cell
from forcemesh import topics
from services.arbiter.watch import STREAMED, delay_trip
from tests.contract.rig import DEMO_CELL
from tests.fakes.arbiter_world import CELL, World
from tests.fakes.lab import Lab

ALLOWED_S = CELL.robot.delay_s + CELL.robot.lag_s
DEMO_TCP = DEMO_CELL.with_name("demo-tcp.yaml")


def measured(world: World, role: str = "robot", **numbers: float) -> World:
    """Let a process report measured numbers."""
    world.change(f"{role}/health", numbers=numbers)
    return world


def refusals(world: World) -> tuple[str, str]:
    """Arm for all and, where that is refused, for jog; return both codes."""
    reply = world.core.arm(world.inputs())
    return reply.code, world.core.arm(world.inputs(), "jog").code


@pytest.mark.parametrize(
    ("role", "numbers", "code"),
    [
        ("robot", {}, "ok"),
        ("robot", {"monitor_speed_fraction": 1.0}, "ok"),
        ("robot", {"monitor_speed_fraction": 0.2}, "ok"),  # 50 mm/s: the speed of a press
        ("robot", {"monitor_speed_fraction": 0.19}, "monitor_speed"),
        ("robot", {"streamed_round_trip_p50_s": 0.99 * ALLOWED_S}, "ok"),
        ("robot", {"streamed_round_trip_p50_s": 1.01 * ALLOWED_S}, "delay"),
        ("robot", {"taken_round_trip_p50_s": 1.0}, "ok"),  # of a program that idled
        ("wrench", {"tare_age_h": 7.9}, "ok"),
        ("wrench", {"tare_age_h": 8.1}, "tare"),
    ],
)
def test_the_preflight_compares_measured_values(role: str, numbers: dict, code: str) -> None:
    """The check is for force feedback only: a jog is always possible."""
    world = measured(World(), role, **numbers).make_ready()
    for_all, for_jog = refusals(world)
    assert for_all == code
    assert for_jog in {"ok", "already"}
    if code == "tare":
        assert "8.1 h old" in " ".join(world.core.status().not_ready)


@pytest.mark.parametrize("to", [0.5, 0.98, 0.0])
def test_a_monitor_speed_that_changes_while_pressing_holds(to: float) -> None:
    """Up or down: the status has both values."""
    world = measured(World(), monitor_speed_fraction=1.0).make_active("regulator")
    assert world.tick(50).permission is not None
    measured(world, monitor_speed_fraction=to)
    assert world.tick().permission is None
    (trip,) = world.core.status().trips
    assert (world.core.state, trip.code) == ("HOLDING", "monitor_speed")
    assert f"became {100 * to:g} %, it was 100 %" in trip.text


@pytest.mark.parametrize(("share", "continues"), [(1.4, True), (1.6, False)])
def test_a_controller_that_becomes_late_while_pressing_holds(share: float, continues: bool) -> None:
    """The limit is 1.5 times the value of the cell file."""
    world = World().make_active("regulator")
    measured(world, streamed_round_trip_p50_s=share * ALLOWED_S)
    assert (world.tick(5).permission is not None) == continues
    if not continues:
        assert world.core.status().trips[0].code == "delay"


@pytest.mark.parametrize("margin", [1.0, 1.5])
def test_a_controller_may_be_as_late_as_the_margin_allows(margin: float) -> None:
    """The limit itself is accepted; the next number is not."""
    limit_s = margin * ALLOWED_S
    assert delay_trip({STREAMED: limit_s}, CELL, margin) is None
    trip = delay_trip({STREAMED: nextafter(limit_s, inf)}, CELL, margin)
    assert trip is not None
    assert (trip.code, trip.limit) == ("delay", limit_s)


def test_the_pendant_s_speed_turned_down_while_an_emulated_arm_presses_holds() -> None:
    """Gateway and shipped program: within a second the arm holds with the reason."""
    lab = Lab(load_cell(DEMO_TCP))
    numbers = lab.cell.client.reader(topics.HEALTH["robot"])
    lab.approach()
    lab.cell.advance(2.5)
    assert lab.force_N > 10.0
    measured_s = lab.now(numbers).numbers["streamed_round_trip_p50_s"]
    assert 0.0 < measured_s < lab.cell.cell.robot.delay_s + lab.cell.cell.robot.lag_s
    controller: Any = lab.cell.runners["sensor"].service
    controller.machine.pendant.monitor_speed(30.0)
    lab.seconds_until(lambda: lab.status.state == "HOLDING", 2.0)
    assert [trip.code for trip in lab.status.trips] == ["monitor_speed"]

"""Figures of the controller in `robot/health`: on a socket, and in lock step."""

from math import isfinite
from typing import Any

import pytest

from controller.packet_table import COUNTER_SPAN
from tests.contract.robots import Both, Emulated

FRAMED = {"framed_round_trip_p50_s", "framed_round_trip_p99_s"}
TAKEN = {"taken_round_trip_p50_s", "taken_round_trip_p99_s"}
RATES = {"program_loop_hz", "sender_hz"}
FROM_103 = {"monitor_speed_fraction", "any_peer_may_connect"}


def counted(emulated: Emulated, name: str):
    """Return the program's own counters."""
    value: Any = emulated.machine.memory.read(name)
    return value


def test_the_gateway_measures_the_program_that_ships() -> None:
    """In lock step: the published figures equal the program's own counters."""
    emulated = Emulated()
    rig = emulated.rig
    assert isinstance(rig.service, Both)
    gateway = rig.service.gateway
    assert gateway.numbers(rig.clock.now_ns()) == {}
    rig.connect()
    rig.arm()
    rig.advance(4.0)
    samples, loops = 0, counted(emulated, "fm.loops")
    for _ in range(2):  # in 4 s the counter wraps
        before = counted(emulated, "fm.sbeat")
        rig.advance(2.0)
        samples += (counted(emulated, "fm.sbeat") - before) % COUNTER_SPAN
    samples_hz = samples / 4.0
    loops_hz = (counted(emulated, "fm.loops") - loops) / 4.0
    numbers = gateway.numbers(rig.clock.now_ns())
    assert set(numbers) == RATES | FRAMED | TAKEN | FROM_103
    assert all(isfinite(number) and number > 0.0 for number in numbers.values())
    assert numbers["any_peer_may_connect"] == 1.0  # fm.peer of the shipped program
    assert numbers["monitor_speed_fraction"] == 1.0
    assert numbers["sender_hz"] == pytest.approx(samples_hz, abs=0.8)
    assert numbers["program_loop_hz"] == pytest.approx(loops_hz, abs=0.8)
    period_s = 1.0 / numbers["sender_hz"]
    assert period_s / 10 < numbers["framed_round_trip_p50_s"] < 3.0 * period_s
    assert numbers["taken_round_trip_p50_s"] >= numbers["framed_round_trip_p50_s"] - period_s

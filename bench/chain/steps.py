"""Processor time of one step of each service while the arm presses.

All services run in turn in one process on a virtual clock, and a loop of plain arithmetic is timed
among them: steps in loops can be compared between machines and days. Times are processor time of
the thread, so other processes disturb only the caches.
"""

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import thread_time_ns
from typing import Any
from unittest.mock import patch

from bench.results import ROOT, Row
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.messages import Law
from launch.virtual_cell import VirtualCell
from sim.robot.engine import mujoco

READY_S, SETTLED_S, TIMED_S = 1.8, 2.0, 4.0  # virtual time
PRESS_N = 20.0
LOOP = range(1000)
COLUMNS = {
    "part": "", "budget_us": ".0f", "median_us": ".0f", "lowest_us": ".0f", "in_loops": ".1f",
}  # fmt: skip


@dataclass(frozen=True)
class Part:
    """A service whose step is measured."""

    budget_us: float
    role: str
    cell: str = "demo.yaml"
    law: Law = "plain"


PARTS = {
    "wrench": Part(120.0, "wrench"),
    "regulator, plain law": Part(200.0, "regulator"),
    "regulator, adaptive law": Part(250.0, "regulator", law="adaptive"),
    "arbiter": Part(250.0, "arbiter"),
    "simulated robot, without MuJoCo": Part(130.0, "robot"),
    "gateway": Part(250.0, "robot", "demo-tcp.yaml"),
}


def row(name: str) -> Row:
    """Return budget and times of a part."""
    part = PARTS[name]
    steps_us, loops_us = times_us(part)
    return {
        "part": name,
        "budget_us": part.budget_us,
        "median_us": median(steps_us),
        "lowest_us": min(steps_us),
        "in_loops": median(steps_us) / median(loops_us),
    }


def times_us(part: Part, timed_s: float = TIMED_S) -> tuple[list[float], list[float]]:
    """Return the times of all steps of a part, and of the loop after each of them [us]."""
    cell, steps_us, loops_us, physics_us = pressing(part), [], [], [0.0]
    service = cell.runners[part.role].service
    step, first, second = service.step, mujoco.mj_step1, mujoco.mj_step2

    def timed(now_ns: int) -> None:
        physics_us[0] = 0.0
        steps_us.append(_took_us(step, now_ns) - physics_us[0])
        loops_us.append(_took_us(_loop))

    def simulated(function: Callable[..., Any]) -> Callable[..., None]:
        def add(*arguments: Any) -> None:
            physics_us[0] += _took_us(function, *arguments)

        return add

    with (
        patch.object(service, "step", timed),
        patch.object(mujoco, "mj_step1", simulated(first)),
        patch.object(mujoco, "mj_step2", simulated(second)),
    ):
        cell.advance(timed_s)
    return steps_us, loops_us


def pressing(part: Part) -> VirtualCell:
    """Return a cell that presses on its plate in mode both."""
    cell = VirtualCell(load_cell(ROOT / "cells" / part.cell, {"sim.gap_m": 0.001}))
    client = ConfiguredCell(cell.cell, commander="operator", bus=cell.client)
    cell.advance(READY_S)
    client.tare()
    client.arm()
    client.force.start(PRESS_N, mode="both", law=part.law)
    cell.advance(SETTLED_S)
    return cell


def _took_us(function: Callable[..., Any], *arguments: Any) -> float:
    began_ns = thread_time_ns()
    function(*arguments)
    return (thread_time_ns() - began_ns) / 1e3


def _loop() -> None:
    total = 0.0
    for number in LOOP:
        total += 0.5 * number

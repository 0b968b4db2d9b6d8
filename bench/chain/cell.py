"""The chain of a simulated cell that presses on its plate, in real processes."""

import os
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.chain.load import Load, measured
from bench.results import ROOT
from common.bus.cell_bus import open_bus
from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import Array
from common.runtime.realtime import request_short_slices
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.messages import OPERATIONAL, ArbiterState, Health, Law
from launch.processes import Supervisor
from tests.chaos.common_net import free_port

PRESS_N, BAND_N = 15.0, 1.0
PRESSING: ArbiterState = "ACTIVE"
ARMED: ArbiterState = "ARMED"
POLL_S = 0.0005
WITHIN_S = 180.0  # also while other work keeps all cores busy
STAGES: dict[str, topics.Topic[Any]] = {
    "wrench": topics.WRENCH,
    "regulator": topics.REGULATOR_TARGET,
    "arbiter": topics.ROBOT_COMMAND,
}
# The simulated robot's process is the sensor as well.
OF_PROCESSES = tuple(role for role in topics.ROLES if role != "sensor")
DROPPED = ("superseded", "lost")  # last word of counters of messages or samples not used


@dataclass(slots=True)
class CellRun:
    """Measurements of one interval of pressing."""

    load: dict[str, Load] = field(default_factory=dict)  # by process
    ages_us: dict[str, dict[int, float]] = field(default_factory=dict)  # stage: sample: age
    dropped: dict[str, int] = field(default_factory=dict)  # by counter, in the interval
    held: str = ""  # why the arm did not press until the end, empty if it did

    @property
    def chain_us(self) -> Array:
        """Times from the sensor's sample to the robot's acceptance [us]."""
        return np.array(list(self.ages_us["robot"].values()))

    def hops_us(self) -> dict[str, Array]:
        """Return the times from each stage to the next, of the same sample [us]."""
        found, before, previous = {}, dict.fromkeys(self.ages_us["wrench"], 0.0), "sensor"
        for stage, ages in self.ages_us.items():
            hops = [age - before[sample] for sample, age in ages.items() if sample in before]
            found[f"{previous} to {stage}"] = np.array(hops)
            before, previous = ages, stage
        return found


def own_demo(name: str, changes: Mapping[str, object] | None = None) -> CellConfig:
    """Return the demo's cell under a name of its own, at a free port."""
    own = {"cell": name, "bus.endpoint": f"tcp/127.0.0.1:{free_port()}"}
    return load_cell(ROOT / "cells" / "demo.yaml", {**own, **(changes or {})})


@contextmanager
def running(cell: CellConfig, file: Path | None = None) -> Iterator[ConfiguredCell]:
    """Run the processes of a cell during the block; yield its client when it is ready."""
    with Supervisor(cell, file) as supervisor:
        supervisor.wait_ready(WITHIN_S)
        with ConfiguredCell(cell, commander="operator") as client:
            client.wait_ready(WITHIN_S)
            yield client


def run(cell: CellConfig, duration_s: float, *, law: Law | None, realtime: bool) -> CellRun:
    """Let a cell press, or without a law be armed only, and measure it for an interval."""
    found = CellRun(ages_us={stage: {} for stage in (*STAGES, "robot")})
    with running(cell) as client, open_bus(cell, topics.CLIENT) as watch:
        health = {role: client.feed(topics.HEALTH[role]) for role in OF_PROCESSES}
        pids = _by_process({role: reading(WITHIN_S).pid for role, reading in health.items()})
        if not realtime:
            for pid in pids.values():
                _give_up_realtime(pid)
        if law is None:
            client.arm(within_s=WITHIN_S)
        else:
            press(client, law)
        found.held = why_held(client)
        if found.held:
            return found
        before = _dropped(reading() for reading in health.values())
        found.load = measured(pids, lambda: _watch(watch, duration_s, found))
        after = _dropped(reading() for reading in health.values())
        found.dropped = {name: count - before[name] for name, count in after.items()}
        found.held = why_held(client, (ARMED,) if law is None else (PRESSING,))
    return found


def press(client: ConfiguredCell, law: Law) -> None:
    """Arm, and wait until the arm presses or holds. Raise ForcemeshError when it is not armed."""
    client.arm(within_s=WITHIN_S)
    client.force.start(PRESS_N, law=law)
    while not why_held(client) and abs(client.force.pressed_N() - PRESS_N) > BAND_N:
        time.sleep(0.1)


def why_held(client: ConfiguredCell, expected: Collection[ArbiterState] = OPERATIONAL) -> str:
    """Return why the state is not an expected one: the trips, or the state; empty if it is."""
    status = client.status()
    if status.state in expected:
        return ""
    return "; ".join(trip.text for trip in status.trips) or status.state


def _watch(bus: Bus, duration_s: float, found: CellRun) -> None:
    """Note the age of each sensor sample when a stage publishes, and when the robot accepts."""
    readers = {stage: bus.reader(topic) for stage, topic in STAGES.items()}
    robot = bus.reader(topics.ROBOT_STATE)
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s:
        time.sleep(POLL_S)
        now_ns = bus.clock.now_ns()
        for stage, reader in readers.items():
            reading = reader.read(now_ns)
            if reading.header is not None and reading.origin is not None:
                age_ns = reading.header.stamp_ns - reading.origin.stamp_ns
                found.ages_us[stage][reading.origin.seq] = age_ns / 1e3
        state = robot.read(now_ns).fresh
        accepted = None if state is None else state.accepted
        if accepted is not None and accepted.sensor_stamp_ns is not None:
            age_ns = accepted.at_ns - accepted.sensor_stamp_ns
            found.ages_us["robot"].setdefault(accepted.sensor_seq or 0, age_ns / 1e3)


def _by_process(pids: Mapping[str, int]) -> dict[str, int]:
    """Return the pid of each process by the names of its roles."""
    roles: dict[int, list[str]] = {}
    for role, pid in pids.items():
        roles.setdefault(pid, []).append(role)
    return {", ".join(names): pid for pid, names in roles.items()}


def _dropped(healths: Iterable[Health]) -> dict[str, int]:
    """Return the counters of messages and samples that were not used."""
    return {
        name: count
        for health in healths
        for name, count in health.counters.items()
        if name.endswith(DROPPED)
    }


def _give_up_realtime(pid: int) -> None:
    """Leave a process what it would have without the right to real-time priority."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        os.sched_setscheduler(int(task.name), os.SCHED_OTHER, os.sched_param(0))
    request_short_slices(pid)

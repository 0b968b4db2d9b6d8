"""Test rig: the simulated arm with the real wrench filter and limits and one law, in one loop.

No bus and no processes: a second of the cell takes a tenth of one. All components that shape the
force are those of the cell: physics, set-point path, sensor, filter, compensation, motion limits.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.config.payload import Payload
from common.motion.convert import vec3
from common.motion.frames import Array
from common.motion.limits import Limits
from common.motion.rate_limiter import CommandedMotion, at_rest, limit_motion
from common.motion.setpoint_monitor import SPEED_MARGIN
from services.wrench.compensation import Compensation, Filter, Wrench
from services.wrench.plausibility import ReadingCheck, ReadingLimits
from sim.robot.arm import SimArm
from sim.robot.motion import MotionGenerator
from sim.robot.settings import TICK_S, SimSettings

CELL = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
CHAIN_TICKS = 1  # from the sensor's sample to the arm's command
STIFFEST_N_M = 2e5
MEAN_S, BAND_N = 0.008, 1.0


@dataclass(frozen=True, slots=True)
class SceneSettings:
    """Parameters of a scene."""

    stiffness_N_m: float = 2e4
    delay_ms: int = 10
    loop_hz: float = 250.0
    delay_error_ms: float = 0.0  # by which the delay is assumed too long
    tilt_deg: float = 0.0
    gap_m: float = 0.005
    tool_mass_kg: float = 1.0
    seed: int = 0
    speed_m_s: float = 0.15
    accel_m_s2: float = 10.0
    overrides: Mapping[str, object] = field(default_factory=dict)  # keys of the cell file

    def cell(self) -> CellConfig:
        """Return the cell file of the benchmark: the demo's, at its own speed and delay."""
        delay_s = self.delay_ms / 1e3
        chosen: dict[str, object] = {
            "rates.control_hz": self.loop_hz,
            "rates.robot_hz": max(self.loop_hz, 100.0),
            "rates.sensor_hz": 1000.0,
            "robot.delay_s": max(0.0, delay_s + self.delay_error_ms / 1e3),
            "force.chain_s": CHAIN_TICKS * TICK_S,
            "force.speed_max_m_s": self.speed_m_s,
            "force.law": "adaptive",
            "filter.median": 5,
            "limits.accel_m_s2": self.accel_m_s2,
            "limits.force_N": 500.0,
            "sensor.force_range_N": 600.0,
            "contact.stiffness_N_m": STIFFEST_N_M,
            "sim.stiffness_N_m": self.stiffness_N_m,
            "sim.delay_s": delay_s,
            "sim.tilt_deg": self.tilt_deg,
            "sim.gap_m": self.gap_m,
            "sim.tool_mass_kg": self.tool_mass_kg,
            "sim.seed": self.seed,
        }
        return load_cell(CELL, {**chosen, **self.overrides})


@dataclass(frozen=True, slots=True)
class LawSample:
    """Inputs of a law at each of its steps."""

    force_N: Array  # base axes, about the TCP
    torque_Nm: Array
    T_base_tcp: pin.SE3  # measured
    T_let_through: pin.SE3  # TCP, commanded
    limited: bool
    dt_s: float


class Pilot(Protocol):
    """Interface of a control law."""

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""


@dataclass(slots=True)
class Trace:
    """Recorded signals, one row per step of the law; means are over the last 8 ms."""

    t_s: list[float] = field(default_factory=list)
    force_N: list[Array] = field(default_factory=list)
    T_base_tcp: list[pin.SE3] = field(default_factory=list)
    lift_off_m: list[float] = field(default_factory=list)
    push_N: list[float] = field(default_factory=list)  # back along the tool's axis

    def add(self, t_s: float, sample: LawSample, lift_off_m: float) -> None:
        """Add a step."""
        self.t_s.append(t_s)
        self.force_N.append(sample.force_N)
        self.T_base_tcp.append(sample.T_base_tcp)
        self.lift_off_m.append(lift_off_m)
        self.push_N.append(-float(np.dot(sample.force_N, sample.T_base_tcp.rotation[:, 2])))

    @property
    def smooth_N(self) -> Array:
        """Means of the push. Shape (n,)."""
        return means(np.array(self.t_s), np.array(self.push_N))

    def after(self, begin_s: float) -> Array:
        """Return the push from a time on [N]. Shape (k,)."""
        return np.array(self.push_N)[np.array(self.t_s) >= begin_s]

    def settling_s(self, setpoint_N: float) -> float | None:
        """Return the time from which the push stays within 1 N; None if it does not."""
        return settling_s(np.array(self.t_s), np.array(self.push_N) - setpoint_N)


def means(t_s: Array, values: Array) -> Array:
    """Return each value averaged over the last few milliseconds. Shape (n,)."""
    first = np.searchsorted(t_s, t_s - MEAN_S)
    total = np.concatenate([[0.0], np.cumsum(values)])
    last = np.arange(1, len(t_s) + 1)
    return np.asarray((total[last] - total[first]) / (last - first))


def settling_s(t_s: Array, error_N: Array) -> float | None:
    """Return the time from which an error stays within 1 N; None if it does not."""
    outside = np.flatnonzero(np.abs(means(t_s, error_N)) > BAND_N)
    if len(outside) == 0:
        return 0.0
    return None if outside[-1] + 1 >= len(t_s) else float(t_s[outside[-1] + 1])


class ForceRig:
    """One arm, one plate, and the loop that moves the arm."""

    def __init__(self, cell: CellConfig) -> None:
        if cell.sim is None:
            raise ValueError("the benchmark needs a simulated cell")
        self.cell = cell
        self.arm = SimArm(SimSettings.of(cell), seed=cell.sim.seed)
        self._limits = Limits.of(cell)
        self._motion = MotionGenerator(
            self.arm.kinematics, self.arm.q, stream_m_s=SPEED_MARGIN * cell.limits.speed_m_s
        )
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self.payload = Payload(
            mass_kg=cell.sim.tool_mass_kg,
            com_m=cell.sim.tool_com_m,
            bias_force_N=cell.sim.bias_force_N,
            bias_torque_Nm=cell.sim.bias_torque_Nm,
            gravity_direction_in_base=cell.gravity_direction_in_base,
        )
        self._T_flange_sensor = cell.sensor.T_flange_sensor.pose
        self._filter = Filter(cell.filter.median, cell.filter.lowpass_s)
        self._check = ReadingCheck(ReadingLimits.of(cell))
        self._sensor_ticks = round(1.0 / cell.rates.sensor_hz / TICK_S)
        self._law_ticks = max(1, round(1.0 / cell.rates.control_hz / TICK_S))
        self._pace: CommandedMotion = at_rest(self.arm.T_base_flange)
        self._in_transit: list[tuple[int, pin.SE3]] = []
        self._limited = False
        self.every_tick: Callable[[ForceRig], object] = lambda _: None
        for _ in range(30):
            self._tick()

    @property
    def T_base_tcp(self) -> pin.SE3:
        """Pose of the TCP that is commanded now."""
        return self._pace.T_base_flange * self._T_flange_tcp

    def wrench(self) -> Wrench:
        """Return the wrench about the TCP, base axes, as the wrench service would publish it."""
        output = self._filter.output
        assert output is not None  # noqa: S101 - the first ticks have filled it
        fx, fy, fz, mx, my, mz = output
        reading = Wrench((fx, fy, fz), (mx, my, mz))
        # Not prepared once: a scene changes the payload.
        compensation = Compensation(self.payload, self._T_flange_sensor, self._T_flange_tcp)
        return compensation.at_tcp(reading, self.arm.T_base_flange)

    def push_N(self) -> float:
        """Return the force that pushes the tool back along its axis."""
        return -float(np.dot(self.wrench().force_N, self.arm.T_base_tcp.rotation[:, 2]))

    def press(self, force_N: float) -> None:
        """Press under position control until the plate pushes back with a force, then rest."""
        k = self.arm.settings.stiffness_N_m
        travel_m = max(0.0, self.arm.lift_off_m) + force_N / k
        for _ in range(8):
            T = self._pace.T_base_flange.copy()
            steps = max(1, int(travel_m / 0.0002)) if travel_m > 0 else 1
            for number in range(steps):
                share = (number + 1) / steps
                aim = T.translation + T.rotation[:, 2] * travel_m * share
                self._motion.setpoint(pin.SE3(T.rotation, aim))
                self._tick()
            for _ in range(100 + self.arm.settings.delay_ticks):
                self._tick()
            T_now = pin.SE3(T.rotation, T.translation + T.rotation[:, 2] * travel_m)
            self._pace = at_rest(T_now)
            travel_m = (force_N - self.push_N()) / k
            if abs(force_N - self.push_N()) < 0.3:
                break

    def run(self, pilot: Pilot, duration_s: float, trace: Trace | None = None) -> Trace:
        """Run a law for a duration; its trace starts at zero or continues."""
        trace = trace or Trace()
        first_s = trace.t_s[-1] + self._law_ticks * TICK_S if trace.t_s else 0.0
        for number in range(round(duration_s / TICK_S / self._law_ticks)):
            sample = self._sample()
            self._command(pilot.step(sample))
            trace.add(first_s + number * self._law_ticks * TICK_S, sample, self.arm.lift_off_m)
            for _ in range(self._law_ticks):
                self._tick()
        return trace

    def _sample(self) -> LawSample:
        wrench = self.wrench()
        return LawSample(
            np.array(wrench.force_N),
            np.array(wrench.torque_Nm),
            self.arm.T_base_tcp,
            self.T_base_tcp,
            self._limited,
            self._law_ticks * TICK_S,
        )

    def _command(self, T_base_tcp: pin.SE3) -> None:
        T_target = T_base_tcp * self._T_flange_tcp.inverse()
        self._pace = limit_motion(self._limits, self._pace, T_target, self._law_ticks * TICK_S)
        self._limited = self._pace.lags
        self._in_transit.append((self.arm.ticks + CHAIN_TICKS, self._pace.T_base_flange))

    def _tick(self) -> None:
        while self._in_transit and self._in_transit[0][0] <= self.arm.ticks:
            self._motion.setpoint(self._in_transit.pop(0)[1])
        self.every_tick(self)
        self.arm.command_joints(self._motion.tick(TICK_S))
        self.arm.step()
        if self.arm.ticks % self._sensor_ticks == 0:
            sample = self.arm.ft_sensor.disturb(self.arm.ft_sensor.sample())
            if sample is not None:
                reading = (*vec3(sample.force_N), *vec3(sample.torque_Nm))
                dt_s = self._sensor_ticks * TICK_S
                self._check.fault_of(reading, dt_s)
                if self._check.accepted:
                    self._filter.feed(reading, dt_s)

"""Drawn jobs of force control, and what happens in them on the simulated arm.

A job is an approach to a plate, a press with a set point, and a surface that rises as a slope under
a tool that is fed across it. The rig is that of the force benchmark: real law, filter and limits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from math import inf

import numpy as np

from bench.force.laws import LawRunner
from bench.force.rig import ForceRig, SceneSettings, Trace
from bench.force.settle import is_steady
from common.config.cell import CellConfig
from control.gain_rule import tune

LAWS = ("adaptive", "plain")
GAP_M = 0.0005
TOUCH_N = 1.0  # mean force of the first touch
CHUNK_S, REST_S = 0.1, 0.5  # a press has settled after so long within 0.8 of the band
LONGEST_S = 15.0
SLOPE_DEG = 10.0
MOST_DELAY_MS = {"adaptive": 60, "plain": 120}  # the laws' own measured ranges
SENSED_KG = 0.2  # of the sensor's own plate, in front of its springs
FOLLOW_S, FOLLOW_TIME_CONSTANTS = 1.5, 4.0


@dataclass(frozen=True, slots=True)
class DrawnJob:
    """Coordinates of a job."""

    law: str
    stiffness_N_m: float
    stiffest_ratio: float  # stiffness of the cell file relative to that of the plate
    delay_ms: int
    period_ms: int  # of the loop
    setpoint_N: float
    feed_m_s: float
    accel_m_s2: float
    speed_max_m_s: float
    tool_mass_kg: float
    approach_share: float  # of the fastest approach that the cell allows
    seed: int

    def cell(self) -> CellConfig:
        """Return the cell file of the job: the demo's, with these values."""
        loop_hz, stiffest = 1e3 / self.period_ms, self.stiffness_N_m * self.stiffest_ratio
        overrides = {
            "rates.robot_hz": loop_hz,
            "filter.median": 3,
            "force.law": self.law,
            "force.approach_m_s": 1e-4,
            "contact.stiffness_N_m": stiffest,
            "contact.inertia_kg": self.tool_mass_kg + SENSED_KG,
        }
        world = SceneSettings(
            self.stiffness_N_m,
            self.delay_ms,
            loop_hz,
            gap_m=GAP_M,
            tool_mass_kg=self.tool_mass_kg,
            seed=self.seed,
            speed_m_s=self.speed_max_m_s,
            accel_m_s2=self.accel_m_s2,
            overrides=overrides,
        )
        fastest_m_s = min(0.01, 5.0 / (stiffest * world.cell().plant.tau_s))
        approach = {"force.approach_m_s": self.approach_share * fastest_m_s}
        return replace(world, overrides=overrides | approach).cell()


@dataclass(frozen=True, slots=True)
class Happened:
    """Result of a job."""

    settling_s: float  # after the first touch; inf: it did not
    peak_N: float
    follow_error_N: float  # largest, on the slope


def drawn(laws: Sequence[str], seed: int) -> Iterator[DrawnJob]:
    """Yield jobs without end, the laws in turn: the same ones for the same seed.

    The stiffest contact of the cell file and its fastest approach are the usual job, so each is
    drawn more often than values beside it.
    """
    rng = np.random.default_rng(seed)

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    for law in cycle(laws):
        k = log(2e3, 1e5)
        yield DrawnJob(
            law,
            stiffness_N_m=k,
            stiffest_ratio=min(max(log(0.7, 4.0), 1.0), 2e5 / k),
            delay_ms=int(rng.integers(0, MOST_DELAY_MS[law] + 1)),
            period_ms=round(log(4.0, 33.0)),
            setpoint_N=log(5.0, 40.0),
            feed_m_s=log(0.005, 0.05),
            accel_m_s2=log(1.0, 10.0),
            speed_max_m_s=log(0.02, 0.15),
            tool_mass_kg=log(0.4, 2.5),
            approach_share=min(log(0.3, 1.5), 1.0),
            seed=int(rng.integers(2**31)),
        )


def run(job: DrawnJob) -> Happened:
    """Run a job on the simulated arm."""
    rig = ForceRig(job.cell())
    pilot = LawRunner(rig, job.law)
    pilot.setpoint_N = job.setpoint_N
    pressed = Trace()
    while not pressed.t_s or pressed.t_s[-1] < LONGEST_S:
        rig.run(pilot, CHUNK_S, pressed)
        if pressed.t_s[-1] > REST_S and is_steady(pressed, job.setpoint_N, REST_S):
            break
    first = int(np.argmax(pressed.smooth_N > TOUCH_N))
    settled_s = pressed.settling_s(job.setpoint_N)
    if settled_s is None or pressed.smooth_N[first] <= TOUCH_N:
        settled_s = inf
    peak_N = float(pressed.smooth_N[first:].max())
    return Happened(settled_s - pressed.t_s[first], peak_N, _follow(rig, pilot, job))


def _follow(rig: ForceRig, pilot: LawRunner, job: DrawnJob) -> float:
    """Return the largest error of the force on the slope [N]."""
    rest_m, start = rig.arm.plate.point_m.copy(), rig.arm.ticks
    speed_m_s = job.feed_m_s * float(np.tan(np.radians(SLOPE_DEG)))

    def rise(rig: ForceRig) -> None:
        up_m = speed_m_s * (rig.arm.ticks - start) * 1e-3
        rig.arm.plate.point_m = rest_m + np.array([0.0, 0.0, up_m])

    rig.every_tick = rise
    gain = tune(rig.cell).force_i_m_per_Ns
    plain_s = FOLLOW_TIME_CONSTANTS / (gain * job.stiffness_N_m)
    followed = rig.run(pilot, FOLLOW_S + (plain_s if job.law == "plain" else 0.0))
    return float(np.abs(followed.smooth_N - job.setpoint_N).max())

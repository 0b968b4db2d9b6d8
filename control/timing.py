"""Timing of one session of force feedback: samples, late inputs, commands in flight. Pure.

A late input does not tell what the commands have done: more of them would add up to a step, so the
law rests. Late is a wrench or a report that came later than three periods of its source, and a
command that the arbiter has not answered for two targets.

The robot reports the set point it sent last. On a working link that is a recent command. If it is
farther from the newest command than every command of the last

    window = delay + chain + 2 reports + 2 samples

the link is stalled: accumulated commands would be sent as one step. Commands added meanwhile came
from forces that the arm had not changed yet: the law returns to the oldest command of the window
and restarts from there. Poses are compared, not numbers of commands: a gateway also sends poses
between two commands, and those have no number.
"""

from collections import deque
from dataclasses import dataclass, field
from math import acos, dist
from operator import mul
from typing import NamedTuple

from common.config.cell import CellConfig
from common.motion.limits import NS_PER_S
from forcemesh.messages import PoseRecord

LATE_INPUT_PERIODS = 3.0  # of an input: beyond, what it says is over
REPORTS, SAMPLES = 2.0, 2.0
SAME_M, SAME_RAD = 1e-5, 1e-4  # tolerance between a sent pose and its command


@dataclass(frozen=True, slots=True)
class TimingSettings:
    """Constants of one cell."""

    late_s: float  # between two samples of the wrench
    late_report_s: float
    longest_s: float  # period over which a law integrates
    may_repeat: bool  # a sensor slower than control: its last sample counts until the next one
    window_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "TimingSettings":
        """Return the constants of a cell."""
        rates, plant = cell.rates, cell.plant
        return cls(
            late_s=LATE_INPUT_PERIODS / min(rates.control_hz, rates.sensor_hz),
            late_report_s=LATE_INPUT_PERIODS / min(rates.control_hz, rates.robot_hz),
            longest_s=LATE_INPUT_PERIODS * (1.0 / rates.control_hz),
            may_repeat=rates.sensor_hz < rates.control_hz,
            window_s=plant.arm.delay_s + REPORTS / plant.robot_hz + SAMPLES / plant.control_hz,
        )


class SampleTime(NamedTuple):
    """What the clock says of one sample."""

    dt_s: float  # since the last one
    pose_is_new: bool  # the robot has reported a pose since then
    is_late: bool


@dataclass(slots=True)
class LoopTiming:
    """Times of a session: its last inputs, and the commands of the last window, oldest first."""

    settings: TimingSettings
    sample_ns: int  # stamp of the last wrench
    origin: object = None  # sensor sample of it
    report: object = None  # header of the robot's last one
    now_s: float = 0.0
    commands: deque[tuple[float, PoseRecord]] = field(default_factory=deque)  # flange in base

    def sample(
        self, stamp_ns: int, origin: object, report: object, report_age_s: float
    ) -> SampleTime | None:
        """Return the times of a new sample; None: a law has integrated it already.

        A wrench may repeat a sample: one of a silent sensor says nothing about the last commands.

        Args:
            stamp_ns: Stamp of the wrench.
            origin: Sensor sample that it is based on; None: unknown.
            report: Header of the robot's last report.
            report_age_s: Its age.
        """
        settings, gap_s = self.settings, (stamp_ns - self.sample_ns) / NS_PER_S
        is_repeated = origin is not None and origin == self.origin
        if gap_s <= 0.0 or (is_repeated and not settings.may_repeat):
            return None
        pose_is_new = report is not self.report
        self.sample_ns, self.origin, self.report = stamp_ns, origin, report
        is_late = gap_s > settings.late_s or report_age_s > settings.late_report_s
        return SampleTime(min(gap_s, settings.longest_s), pose_is_new, is_late)

    def lags(self, command: PoseRecord, dt_s: float, sent: PoseRecord | None) -> bool:
        """Add a command; return whether the sent pose is behind every command of the window.

        Args:
            command: The command.
            dt_s: Time since the last one.
            sent: Pose that the robot has sent last; None: unknown, which is no lag.
        """
        self.now_s += dt_s
        commands = self.commands
        while commands and commands[0][0] < self.now_s - self.settings.window_s:
            commands.popleft()
        commands.append((self.now_s, command))
        if sent is None:
            return False
        p_m, behind_m = command.position_m, dist(command.position_m, sent.position_m) - SAME_M
        behind_rad = _angle_rad(command, sent) - SAME_RAD
        # The oldest one is mostly far enough from the newest.
        lags = all(dist(p_m, each.position_m) < behind_m for _, each in commands)
        return lags or all(_angle_rad(command, each) < behind_rad for _, each in commands)

    def restart(self) -> PoseRecord:
        """Keep only the oldest command, which should have been sent by now; return it."""
        _, oldest = self.commands[0]
        self.commands = deque([(self.now_s, oldest)])
        return oldest


def _angle_rad(a: PoseRecord, b: PoseRecord) -> float:  # to 1e-7
    return 2.0 * acos(min(abs(sum(map(mul, a.orientation_xyzw, b.orientation_xyzw))), 1.0))

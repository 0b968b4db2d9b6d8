"""Hand guiding by admittance control: record of the flange path, and its playback."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from cli.skills.contact_monitor import (
    ContactMonitor,
    ContactSample,
    ReportProgress,
    no_progress,
    stop_force_at_end,
)
from cli.skills.path_file import thinned
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import record_of
from forcemesh.messages import Mode
from forcemesh.requests import ForceStartRequest

RECORD_S = 0.02


@dataclass(slots=True)
class GuidedPath:
    """Recorded path of the flange in base; it grows while the arm is guided."""

    times_s: list[float] = field(default_factory=list)
    poses: list[pin.SE3] = field(default_factory=list)
    peak_N: float = 0.0

    @property
    def length_mm(self) -> float:
        """Length of the flange path."""
        places = np.array([T.translation for T in self.poses]).reshape(-1, 3)
        return 1e3 * float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def guide(
    cell: ConfiguredCell,
    recording: GuidedPath,
    *,
    mode: Mode,
    seconds: float,
    is_finished: Callable[[], bool],
    progress: ReportProgress = no_progress,
) -> None:
    """Let a hand guide the tool for a period, or until `is_finished` returns true.

    Args:
        cell: An armed cell; the tool is free of contact at the start.
        recording: Receives the samples, also when an error ends the guiding.
        mode: Guided motion: `position`, `orientation` or both.
        seconds: Longest time [s].
        is_finished: Called at each sample.
        progress: Receives the progress.

    Raises:
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    monitor = ContactMonitor(cell)
    T_tcp_flange = cell.config.tool.T_flange_tcp.pose.inverse()

    def add_sample(sample: ContactSample) -> bool:
        if not recording.times_s or sample.t_s - recording.times_s[-1] >= RECORD_S:
            recording.times_s.append(sample.t_s)
            recording.poses.append(sample.T_base_tcp * T_tcp_flange)
        recording.peak_N = max(recording.peak_N, float(np.linalg.norm(sample.force_N)))
        return sample.t_s >= seconds or is_finished()

    with stop_force_at_end(cell):
        cell.force.begin(ForceStartRequest(mode=mode, law="admittance"))
        monitor.until(add_sample, within_s=seconds + 1.0, label="guided", progress=progress)


def play_back(
    cell: ConfiguredCell,
    recorded: Sequence[pin.SE3],
    *,
    tolerance_m: float,
    speed_m_s: float | None,
    progress: ReportProgress = no_progress,
) -> int:
    """Move along recorded poses of the flange with a stop at each; return their number.

    These are ordinary moves without force feedback; only the arbiter's limits stop them.

    Raises RefusedError, ArmStoppedError, NotReachedError, LostError as a move does.
    """
    poses = thinned(recorded, tolerance_m)
    for number, T in enumerate(poses):
        progress(float(number), float(len(poses)), f"pose {number + 1} of {len(poses)}")
        pose = record_of(T)
        cell.move.to(pose.position_m, pose.orientation_xyzw, speed_m_s=speed_m_s)
    return len(poses)

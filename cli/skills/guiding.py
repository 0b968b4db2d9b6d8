"""Hand guiding: the tool follows a hand, the way is written down, and gone again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from cli.skills.contact_monitor import Feeler, Felt, Tell, force_ends, silent
from cli.skills.path_file import thinned, write_poses
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import record_of
from forcemesh.messages import Mode
from forcemesh.requests import ForceStartRequest, MoveRequest

RECORD_S = 0.02


@dataclass(slots=True)
class Recording:
    """Where the flange was, in base; it grows while the hand guides."""

    times_s: list[float] = field(default_factory=list)
    poses: list[pin.SE3] = field(default_factory=list)
    peak_N: float = 0.0

    @property
    def way_mm(self) -> float:
        """Length of the way of the flange."""
        places = np.array([T.translation for T in self.poses]).reshape(-1, 3)
        return 1e3 * float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())

    def save(self, path: Path) -> None:
        """Write it. Raises DataError when the file cannot be written."""
        write_poses(path, self.times_s, self.poses)


def guide(
    cell: ConfiguredCell,
    recording: Recording,
    *,
    mode: Mode,
    seconds: float,
    enough: Callable[[], bool],
    tell: Tell = silent,
) -> None:
    """Let the tool give way to a hand for a while, or until it is enough.

    Args:
        cell: An armed cell; nothing touches the tool when it begins.
        recording: What happens is written into it, however it ends.
        mode: What the hand may move: `position`, `orientation` or both.
        seconds: Longest time.
        enough: Asked at each sample.
        tell: Told how it goes.

    Raises:
        RefusedError, ArmStoppedError, LostError: As the client raises them.
    """
    feeler = Feeler(cell)
    T_tcp_flange = cell.config.tool.T_flange_tcp.pose.inverse()

    def see(felt: Felt) -> bool:
        if not recording.times_s or felt.t_s - recording.times_s[-1] >= RECORD_S:
            recording.times_s.append(felt.t_s)
            recording.poses.append(felt.T_base_tcp * T_tcp_flange)
        recording.peak_N = max(recording.peak_N, float(np.linalg.norm(felt.force_N)))
        return felt.t_s >= seconds or enough()

    with force_ends(cell):
        cell.force.begin(ForceStartRequest(mode=mode, law="admittance"))
        feeler.until(see, within_s=seconds + 1.0, what="guided", tell=tell)


def play_back(
    cell: ConfiguredCell,
    recorded: Sequence[pin.SE3],
    *,
    tolerance_m: float,
    speed_m_s: float | None,
    tell: Tell = silent,
) -> int:
    """Go along recorded poses of the flange; rests at each. Returns how many were needed.

    Nothing is felt: it is an ordinary move, and the arbiter's limits alone stop it.

    Raises RefusedError, ArmStoppedError, NotReachedError, LostError as a move does.
    """
    poses = thinned(recorded, tolerance_m)
    for number, T in enumerate(poses):
        tell(float(number), float(len(poses)), f"pose {number + 1} of {len(poses)}")
        record = record_of(T)
        asked = MoveRequest(
            kind="pose", pose=record, speed_m_s=speed_m_s, commander=cell.session.commander
        )
        cell.move.begin(asked).wait()
    return len(poses)

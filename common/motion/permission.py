"""The robot's side of the arbiter's permission: the same gate in every process that moves an arm.

A command counts while it is fresh and carries a permission. Once a permission was missed or taken
away, its lease is dead: whatever comes under it later is refused, until the arbiter opens a new
lease (and it does so only when a person arms again). So nothing resumes by itself after a freeze.

Under one lease the arm passes from owner to owner; each has a turn with a number of its own. The
number is echoed, and neither leases nor turns of one arbiter go back: what belongs to an owner
before is refused, and kills the lease, because only a stranger would send it.
"""

from dataclasses import dataclass

from forcemesh.bus import LONGEST_FAULT, Reading
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Accepted, Permission, RobotCommand


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the robot may do now: obey a command, or hold and say why."""

    command: RobotCommand | None
    hold_reason: str  # empty when the command is to be obeyed
    hold_code: str  # the same as a code of forcemesh/faults.py
    accepted: Accepted | None  # echo of the last command that was obeyed
    is_new: bool = False  # the command was not seen before


MOST_DEAD = 64  # leases that are remembered: the reader of the bus bounds former writers alike
NO_COMMAND_YET = Verdict(None, "no command yet", "no_lease", None)


class CommandGate:
    """Judges `robot/command` each period; keeps dead leases dead."""

    def __init__(self) -> None:
        """Start without permission."""
        self._accepted: Accepted | None = None
        self._live_lease: tuple[int, int] | None = None  # arbiter's epoch, lease
        self._dead: dict[tuple[int, int], tuple[str, str]] = {}  # lease: why it ended, as a code
        self._newest = (0, 0, 0)  # arbiter's epoch, lease, turn

    def judge(self, reading: Reading[RobotCommand], now_ns: int) -> Verdict:
        """Return what the robot may do at this time."""
        command, header = reading.fresh, reading.header
        if command is None or header is None:
            return self._refuse(reading.fault, reading.code)
        permission = command.permission
        is_over = permission is not None and self._is_over(header.epoch, permission)
        if reading.conflict:
            return self._refuse("two processes write robot/command", "two_writers")
        if permission is None:
            return self._refuse(command.reason or "the arbiter holds", command.code or "hold")
        if reading.age_s > permission.deadline_s:
            age_ms, limit_ms = reading.age_s * 1e3, permission.deadline_s * 1e3
            reason = f"permission {age_ms:.0f} ms old, limit {limit_ms:.0f} ms"
            return self._refuse(reason, "stale")
        if is_over:
            reason = f"lease {permission.lease} turn {permission.turn} is over"
            return self._refuse(reason, "no_lease")
        lease = (header.epoch, permission.lease)
        if lease in self._dead:
            why, code = self._dead[lease]
            return self._refuse(f"lease {lease[1]} ended: {why}", code)
        self._live_lease = lease
        previous = self._accepted
        is_new = previous is None or (previous.epoch, previous.seq) != (header.epoch, header.seq)
        if is_new:
            self._accepted = Accepted(
                epoch=header.epoch,
                seq=header.seq,
                turn=permission.turn,
                at_ns=now_ns,
                sensor_stamp_ns=header.sensor_stamp_ns,
                sensor_seq=header.sensor_seq,
            )
        return Verdict(command, "", "", self._accepted, is_new)

    def _is_over(self, epoch: int, permission: Permission) -> bool:
        """Tell whether a newer turn of this arbiter was seen, and be it one that was refused."""
        seen = (epoch, permission.lease, permission.turn)
        if epoch == self._newest[0] and seen < self._newest:
            return True
        self._newest = seen
        return False

    def revoke(self, reason: str, code: str) -> Verdict:
        """End the live lease from the robot's side: it was asked for what it cannot do."""
        return self._refuse(reason, code)

    def _refuse(self, reason: str, code: str) -> Verdict:
        """Hold, and let nothing come back under the lease that was live."""
        if self._live_lease is not None:
            self._dead[self._live_lease] = (reason, code)
            self._live_lease = None
            if len(self._dead) > MOST_DEAD:
                del self._dead[next(iter(self._dead))]
        return self._hold(reason, code)

    def _hold(self, reason: str, code: str) -> Verdict:
        reason = reason[:LONGEST_FAULT] or "no permission"
        return Verdict(None, reason, code or "no_lease", self._accepted)


def chain_latency_s(accepted: Accepted) -> float | None:
    """Return the time from sensor sample to robot [s]; both stamps must be of one clock."""
    if accepted.sensor_stamp_ns is None:
        return None
    return (accepted.at_ns - accepted.sensor_stamp_ns) / NS_PER_S

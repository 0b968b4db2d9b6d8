"""Command gate on the robot's side: checks lease and permission in every process that moves an arm.

A command is valid while it is fresh and carries a permission. Once a permission is missed or
withdrawn, its lease is dead: every later command under it is refused, until the arbiter opens a new
lease, which requires a person to arm again. So motion never resumes by itself after a freeze.

Under one lease the arm passes from owner to owner; each has its own turn number. The number is
echoed, and leases and turns of one arbiter only increase: a command of an earlier owner is refused
and ends the lease, because only an unexpected publisher would send it.
"""

from typing import NamedTuple

from forcemesh.bus import Reading
from forcemesh.faults import FAULTS, clipped, tripped
from forcemesh.messages import Accepted, Commander, RobotCommand, Trip

# fmt: off
RANKS: dict[Commander, int] = {
    "none":      0,  # no commander
    "regulator": 1,  # force feedback, started by any client
    "program":   2,  # a script
    "operator":  3,  # a person
}
# fmt: on


def outranks(asker: Commander, holder: Commander) -> bool:
    """Return whether a commander may take the arm from its holder."""
    return RANKS[asker] > RANKS[holder]


class GateDecision(NamedTuple):
    """Decision of the gate: execute a command, or hold for a reason."""

    command: RobotCommand | None
    hold: Trip | None  # None when the command is to be executed
    accepted: Accepted | None  # echo of the last accepted command
    is_new: bool = False  # first time that this command is received

    @property
    def hold_reason(self) -> str:
        """Text of `hold`, empty when the command is to be executed."""
        return "" if self.hold is None else self.hold.text

    @property
    def hold_code(self) -> str:
        """Code of `hold`, empty when the command is to be executed."""
        return "" if self.hold is None else self.hold.code


MOST_ENDED_LEASES = 64  # stored leases: the bus reader bounds former publishers in the same way
NO_COMMAND_YET = GateDecision(None, tripped("no_lease", "no command yet"), None)


class CommandGate:
    """Check of `robot/command` in each period; dead leases stay dead."""

    def __init__(self) -> None:
        """Start without permission."""
        self._accepted: Accepted | None = None
        self._live_lease: tuple[int, int] | None = None  # arbiter's epoch, lease
        self._ended_leases: dict[tuple[int, int], Trip] = {}  # lease: what ended it
        self._newest = (0, 0, 0)  # arbiter's epoch, lease, turn

    def judge(self, reading: Reading[RobotCommand], now_ns: int) -> GateDecision:
        """Return the decision at this time."""
        command, header = reading.fresh, reading.header
        if command is None or header is None:
            return self._refuse(_trip(reading.code, reading.fault))
        permission, is_over = command.permission, False
        if permission is not None:  # a newer ownership counts even in a refused command
            permitted = (header.epoch, permission.lease, permission.ownership)
            is_over = header.epoch == self._newest[0] and permitted < self._newest
            self._newest = self._newest if is_over else permitted
        if reading.conflict:
            return self._refuse(tripped("two_writers", "two processes write robot/command"))
        if permission is None:
            return self._refuse(
                _trip(command.code or "hold", command.reason or "the arbiter holds")
            )
        if reading.age_s > permission.deadline_s:
            age_ms, limit_ms = reading.age_s * 1e3, permission.deadline_s * 1e3
            reason = f"permission {age_ms:.0f} ms old, limit {limit_ms:.0f} ms"
            return self._refuse(
                tripped("stale", reason, value=reading.age_s, limit=permission.deadline_s, unit="s")
            )
        if is_over:
            reason = f"lease {permission.lease} owner {permission.ownership} is over"
            return self._refuse(tripped("no_lease", reason))
        lease = (header.epoch, permission.lease)
        if lease in self._ended_leases:
            cause = self._ended_leases[lease]
            text = clipped(f"lease {lease[1]} ended: {cause.text}")
            return self._refuse(cause.replaced(text=text))
        self._live_lease = lease
        previous = self._accepted
        is_new = previous is None or (previous.epoch, previous.seq) != (header.epoch, header.seq)
        if is_new:
            self._accepted = Accepted(
                epoch=header.epoch,
                seq=header.seq,
                ownership=permission.ownership,
                at_ns=now_ns,
                sensor_stamp_ns=header.sensor_stamp_ns,
                sensor_seq=header.sensor_seq,
            )
        return GateDecision(command, None, self._accepted, is_new)

    def revoke(self, cause: Trip) -> GateDecision:
        """End the live lease from the robot's side, after a command that it cannot execute."""
        return self._refuse(cause)

    def _refuse(self, cause: Trip) -> GateDecision:
        """Hold, and mark the live lease as dead."""
        if self._live_lease is not None:
            self._ended_leases[self._live_lease] = cause
            self._live_lease = None
            if len(self._ended_leases) > MOST_ENDED_LEASES:
                del self._ended_leases[next(iter(self._ended_leases))]
        return GateDecision(None, cause, self._accepted)


def _trip(code: str, reason: str) -> Trip:
    """Return what another process reports as a trip; its code may be of another version."""
    return tripped(code if code in FAULTS else "no_lease", reason or "no permission")

"""Command gate on the robot's side: checks lease and permission in every process that moves an arm.

A command is valid while it is fresh and carries a permission that repeats the challenge, a number
that the gate draws at its start and after each dead lease. Once a permission is missed or
withdrawn, its lease is dead: every later command under it is refused, until the arbiter opens a new
lease with the new challenge, which requires a person to arm again. So motion never resumes by
itself after a freeze, and a recorded stream moves no arm.

Under one lease the arm passes from owner to owner; each has its own turn number. The number is
echoed, and leases and turns of one arbiter only increase: a command of an earlier owner is refused
and ends the lease, because only an unexpected publisher would send it.
"""

from random import Random
from typing import NamedTuple

from forcemesh.bus import Reading
from forcemesh.faults import FAULTS, clipped, tripped
from forcemesh.messages import Accepted, Commander, Permission, RobotCommand, Trip

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


CHALLENGES = 2**53  # drawn below: exact where every number is a float
NO_COMMAND_YET = GateDecision(None, tripped("no_lease", "no command yet"), None)


class CommandGate:
    """Check of `robot/command` in each period; dead leases stay dead."""

    def __init__(self, epoch: int) -> None:
        """Start without permission; the epoch of the process, drawn at its start, is the seed."""
        self._epoch, self._dead_leases = epoch, 0
        self._draw()
        self._accepted: Accepted | None = None
        self._is_live = False  # a lease with the present challenge
        self._ended: dict[int, Trip] = {}  # challenge of the last dead lease: what ended it
        self._newest = (0, 0, 0)  # arbiter's epoch, lease, turn

    def judge(self, reading: Reading[RobotCommand], now_ns: int) -> GateDecision:
        """Return the decision at this time."""
        command, header = reading.fresh, reading.header
        if command is None or header is None:
            return self._refuse(_trip(reading.code, reading.fault))
        permission, is_over = command.permission, False
        is_ours = permission is not None and permission.challenge == self.challenge
        if permission is not None and is_ours:  # a newer ownership counts also if refused
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
        if not is_ours:
            return self._refuse(self._of_another_life(permission))
        if is_over:
            reason = f"lease {permission.lease} owner {permission.ownership} is over"
            return self._refuse(tripped("no_lease", reason))
        self._is_live = True
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
        """Hold; a live lease is dead from now on."""
        if self._is_live:
            self._is_live, self._ended = False, {self.challenge: cause}
            self._dead_leases += 1
            self._draw()
        return GateDecision(None, cause, self._accepted)

    def _draw(self) -> None:
        """Draw the challenge of the next lease."""
        rng = Random(f"{self._epoch} {self._dead_leases}")  # noqa: S311 - new, but no secret
        self.challenge = rng.randrange(1, CHALLENGES)

    def _of_another_life(self, permission: Permission) -> Trip:
        """Return why a permission with another challenge is refused."""
        if (cause := self._ended.get(permission.challenge)) is not None:
            return cause.replaced(text=clipped(f"lease {permission.lease} ended: {cause.text}"))
        reason = (
            f"the permission repeats challenge {permission.challenge}, the present one is "
            f"{self.challenge}: it is of an ended lease, of another start or of another cell"
        )
        return tripped("no_lease", reason)


def _trip(code: str, reason: str) -> Trip:
    """Return what another process reports as a trip; its code may be of another version."""
    return tripped(code if code in FAULTS else "no_lease", reason or "no permission")

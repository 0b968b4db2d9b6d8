"""What is to be sent to the controller when its turn comes: of each kind the newest. Pure."""

from collections.abc import Iterator

import pinocchio as pin

from services.gateway import commands
from services.gateway.commands import Command, Pacing, PoseCarry
from services.gateway.scales import Scales


class Offers:
    """Set points of a stream, or wrench, centre and gains of force feedback that runs."""

    def __init__(self, scales: Scales, pacing: Pacing) -> None:
        """Nothing waits, and no rounding is carried."""
        self.wrench: Command | None = None
        self.centre: Command | None = None
        self.gains: tuple[Command, ...] = ()
        self.sent_gains: tuple[Command, ...] = ()
        self._scales, self._pacing = scales, pacing
        self._setpoint: pin.SE3 | None = None
        self._carry = PoseCarry()

    def forget(self) -> None:
        """Let nothing wait any more."""
        self._setpoint = self.wrench = self.centre = None
        self.gains = ()

    def offer_setpoint(self, T_base_flange: pin.SE3) -> None:
        """Let a pose wait. Raises LocalProtocolError for one that does not fit into a packet."""
        commands.move_to_pose(T_base_flange, self._scales, self._carry)
        self._setpoint = T_base_flange

    def due_to_ring(self, now_ns: int, *, room: int) -> Iterator[Command]:
        """Take what goes now to the robot program, which may have so many more under way.

        Gains are up to two commands and go together: both are of one moment.
        """
        for take in (self._take_setpoint, self._take_centre, self._take_gains):
            taken = take(now_ns) if room > 0 else ()
            room -= len(taken)
            yield from taken

    def _take_setpoint(self, now_ns: int) -> tuple[Command, ...]:
        if (wanted := self._setpoint) is None:
            return ()
        if (leaves := self._pacing.leave(wanted, now_ns)) is None:
            return ()
        command, self._carry = commands.move_to_pose(leaves, self._scales, self._carry)
        self._setpoint = None if leaves is wanted else wanted
        return (command,)

    def _take_centre(self, _: int) -> tuple[Command, ...]:
        centre, self.centre = self.centre, None
        return () if centre is None else (centre,)

    def _take_gains(self, _: int) -> tuple[Command, ...]:
        if not self.gains:
            return ()
        new = tuple(command for command in self.gains if command not in self.sent_gains)
        self.sent_gains, self.gains = self.gains, ()
        return new

"""Pending commands to the controller: the newest of each kind. Pure."""

import pinocchio as pin

from controller.packet_table import CentreParam
from forcemesh.messages import Gains, Vec3
from services.gateway import commands
from services.gateway.commands import Command, Pacing, PoseCarry
from services.gateway.scales import Scales


class PendingCommands:
    """Pending set point of a stream, or wrench, centre and gains of running force feedback.

    Raises LocalProtocolError on offering a value that does not fit into a packet.
    """

    def __init__(self, scales: Scales, pacing: Pacing, running: Gains | None = None) -> None:
        """Start empty, without carried rounding; `running`: gains at the start of feedback."""
        self._scales, self._pacing = scales, pacing
        self._sent_gains: tuple[Command, ...] = () if running is None else commands.gains(running)
        # The controller's set point is zero after a hold, a stop and hello.
        self._sent_setpoint = commands.force_set_point((0.0, 0.0, 0.0), scales)
        self._carry = PoseCarry()
        self.clear()

    def clear(self) -> None:
        """Drop all pending commands."""
        self._setpoint: pin.SE3 | None = None
        self._wrench: tuple[Command, ...] = ()
        self._centre: tuple[Command, ...] = ()
        self._gains: tuple[Command, ...] = ()

    def setpoint(self, T_base_flange: pin.SE3) -> None:
        """Store a pose."""
        commands.set_point(T_base_flange, self._scales, self._carry)
        self._setpoint = T_base_flange

    def wrench(self, force_N: Vec3, torque_Nm: Vec3, setpoint_N: Vec3) -> None:
        """Store a wrench and its set point."""
        setpoint = commands.force_set_point(setpoint_N, self._scales)
        self._wrench = (setpoint, commands.wrench(force_N, torque_Nm, self._scales))

    def centre(self, T_flange_tcp: pin.SE3) -> None:
        """Store a centre of rotation."""
        self._centre = (commands.tcp(T_flange_tcp, self._scales, CentreParam.CENTRE),)

    def gains(self, gains: Gains) -> None:
        """Store both sets of gains."""
        self._gains = commands.gains(gains)

    def take_for_ring(self, now_ns: int) -> tuple[Command, ...]:
        """Remove and return the next commands for the ring: of one kind, gains before a centre.

        Gains are at most two commands, those that differ from the controller's.
        """
        return self._take_setpoint(now_ns) or self._take_gains() or self._take_centre()

    def take_wrench(self) -> tuple[Command, ...]:
        """Remove and return the wrench, which bypasses the ring, after its set point if new."""
        wrench, self._wrench = self._wrench, ()
        if not wrench or wrench[0] == self._sent_setpoint:
            return wrench[1:]
        self._sent_setpoint = wrench[0]
        return wrench

    def _take_setpoint(self, now_ns: int) -> tuple[Command, ...]:
        if (target := self._setpoint) is None:
            return ()
        if (released := self._pacing.release(target, now_ns)) is None:
            return ()
        command, self._carry = commands.set_point(released, self._scales, self._carry)
        self._setpoint = None if released is target else target
        return (command,)

    def _take_gains(self) -> tuple[Command, ...]:
        if not self._gains:
            return ()
        new = tuple(command for command in self._gains if command not in self._sent_gains)
        self._sent_gains, self._gains = self._gains, ()
        return new

    def _take_centre(self) -> tuple[Command, ...]:
        centre, self._centre = self._centre, ()
        return centre

"""Our commands as those of protocol plain: the specification's a) to g) alone. Pure.

A command with a counterpart becomes command 1 to 7 in the units of the other packet. Hello, limits,
TCP, heartbeat and set point of force have none and become nothing.

- Hold is a rotation of the joints by zero: plain.as ends the motion and force feedback before it.
- Command 4 is reading minus set point, shortened to the error that moves the tool at its highest
  speed. Force feedback runs at that speed of command 5: plain.as has no limit of its own.
"""

from math import degrees

from common.config.cell import ForceSection
from common.motion.limits import share_at
from controller.packet import VALUE_MAX, VALUE_MIN, ZERO_VEC, Packet, VecInt
from controller.packet_table import (
    FEEDBACK_BITS,
    GAIN_I,
    TABLE,
    Com,
    FeedbackSwitch,
    GainKind,
    Scales,
    Status,
)
from controller.plain import PlainSection
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Speed
from services.gateway.packets import Command, speeds

MOTIONS = (Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS)
STAND_STILL = Command(Com.MOVE_BY_JOINTS)
BITS = {
    FeedbackSwitch.POSITION: Status.POSITION_FEEDBACK,
    FeedbackSwitch.ORIENTATION: Status.ORIENTATION_FEEDBACK,
}


class PlainCommands:
    """Translation of the commands of one connection, in their order."""

    def __init__(self, scales: Scales, settings: PlainSection, force: ForceSection) -> None:
        """Begin a connection, at whose start plain.as holds the arm."""
        self.after = Status.HELD  # force feedback and hold, once all commands so far are taken
        self._scales, self._settings = scales, settings
        self._fastest_mm_s = force.speed_max_m_s * 1e3
        self._fastest_deg_s = degrees(force.speed_max_rad_s)
        self._feedback_speed = speeds(Speed(mechanical_m_s=force.speed_max_m_s), scales)
        self._speed = self._feedback_speed  # of motions: the last one commanded
        self._is_slowed = False  # force feedback has set its own
        self._may_move = False  # something was commanded since the last hold
        self._set_point = ZERO_VEC
        self._Ki: tuple[float, ...] = (0.0,) * 6  # [mm/(N s)], [deg/(N m s)]

    def translated(self, packet: Packet) -> tuple[Command, ...]:
        """Return the commands to send for one of ours; none for one without a counterpart.

        Raises LocalProtocolError for a set point of a stream, and a gain that would be sent as 0.
        """
        com = Com(packet.com)
        if com == Com.SET_POINT:
            raise LocalProtocolError(
                "gateway.protocol is plain, which has no command for a stream of set points"
            )
        if com == Com.HOLD:
            return self._hold()
        if com == Com.FEEDBACK:
            return self._feedback(FeedbackSwitch(packet.param))
        if com == Com.FORCE_SET_POINT:
            self._set_point = packet.vec
        if com in MOTIONS:
            return self._motion(packet)
        others = {Com.WRENCH: self._wrench, Com.SPEEDS: self._speeds, Com.GAINS: self._gains}
        return others[com](packet) if com in others else ()

    # --- motions ----------------------------------------------------------------------------------

    def _hold(self) -> tuple[Command, ...]:
        stop = (STAND_STILL,) if self._may_move else ()
        self._may_move, self.after, self._set_point = False, Status.HELD, ZERO_VEC
        return stop

    def _motion(self, packet: Packet) -> tuple[Command, ...]:
        speed = (self._plain(self._speed),) if self._is_slowed else ()
        self._is_slowed, self._may_move, self.after = False, True, Status(0)
        return (*speed, self._plain(_command(packet)))

    def _speeds(self, packet: Packet) -> tuple[Command, ...]:
        self._speed, self._is_slowed = _command(packet), False
        return (self._plain(self._speed),)

    # --- force feedback ---------------------------------------------------------------------------

    def _feedback(self, switch: FeedbackSwitch) -> tuple[Command, ...]:
        command = Command(Com.FEEDBACK, int(switch))
        if switch == FeedbackSwitch.STOP:
            self.after, self._set_point = self.after & ~FEEDBACK_BITS, ZERO_VEC
            return (command,)
        speed = () if self._is_slowed else (self._plain(self._feedback_speed),)
        self._is_slowed = self._may_move = True
        self.after = self.after & FEEDBACK_BITS | BITS[switch]
        return (*speed, command)

    def _gains(self, packet: Packet) -> tuple[Command, ...]:
        command = self._plain(_command(packet))
        numbers = TABLE[Com.GAINS].numbers(packet.param)
        for number, ours, sent in zip(numbers, packet.vec, command.vec, strict=True):
            if ours and not sent:
                field = "gain_i" if packet.param == GainKind.INTEGRAL else "gain_p"
                raise LocalProtocolError(
                    f"{number.name} is too small for gateway.plain.{field}, "
                    f"{self._settings.units(number)}: it would be sent as 0; increase the scale "
                    "there and in pl.config of plain.as"
                )
        if packet.param == GainKind.INTEGRAL:
            self._Ki = tuple(gain / GAIN_I for gain in packet.vec)
        return (command,)

    def _wrench(self, packet: Packet) -> tuple[Command, ...]:
        """Return the error, with no more of force or torque than moves at the highest speed."""
        errors = [a - b for a, b in zip(packet.vec, self._set_point, strict=True)]
        scales, settings = self._scales, self._settings
        shortened: list[int] = []
        for first, own, units, fastest in (
            (0, scales.force_per_N, settings.force_per_N, self._fastest_mm_s),
            (3, scales.torque_per_Nm, settings.torque_per_Nm, self._fastest_deg_s),
        ):
            part = [error / own for error in errors[first : first + 3]]
            share = share_at(fastest, part, self._Ki[first : first + 3])
            shortened += [round(share * error * units) for error in part]
        a, b, c, d, e, f = shortened
        return (Command(Com.WRENCH, 0, (a, b, c, d, e, f)),)

    # --- units ------------------------------------------------------------------------------------

    def _plain(self, command: Command) -> Command:
        numbers = TABLE[command.com].numbers(command.param)
        vec = list(command.vec)
        for place, number in enumerate(numbers):
            own = number.units(self._scales)
            vec[place] = round(vec[place] / own * self._settings.units(number))
        a, b, c, d, e, f = vec
        return Command(command.com, command.param, (a, b, c, d, e, f))


def _command(packet: Packet) -> Command:
    return Command(Com(packet.com), packet.param, packet.vec)


def own_vector(report: Packet, scales: Scales, settings: PlainSection) -> VecInt:
    """Return the vector of a report of protocol plain in the units of our own.

    Raises RemoteProtocolError for a number that does not fit into our packet.
    """
    vec = []
    for number, value in zip(TABLE[report.com].numbers(0), report.vec, strict=True):
        own = round(value / settings.units(number) * number.units(scales))
        if not VALUE_MIN <= own <= VALUE_MAX:
            raise RemoteProtocolError(
                f"{number.label} of a report is {value / settings.units(number):g}: are the scales "
                "of gateway.plain those of pl.config?"
            )
        vec.append(own)
    a, b, c, d, e, f = vec
    return (a, b, c, d, e, f)

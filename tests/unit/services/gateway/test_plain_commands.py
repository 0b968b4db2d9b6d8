"""Translation of our commands to the specification's a) to g): units, holds, speeds, and errors."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell import ForceSection
from controller.packet import ZERO_VEC, Packet
from controller.packet_table import COMMANDS, GAIN_I, ID_FIRST, TABLE, Com, Scales, Status
from controller.plain import COMMANDS as PLAIN_COMMANDS
from controller.plain import PlainSection
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Gains
from services.gateway.packets import Command, gains
from services.gateway.plain_commands import STAND_STILL, PlainCommands, own_vector

SCALES = Scales()
FORCE = ForceSection(speed_max_m_s=0.02, speed_max_rad_s=0.5)
SLOW = Command(Com.SPEEDS, 0, (100, 100, 100, 20, 0, 0))  # that of force feedback, whole units
FAST = (10_000, 5_000, 10_000, 900, 0, 0)  # ours: 100, 50, 100 %, 90 mm/s


def packet(com: Com, param: int = 0, vec=ZERO_VEC) -> Packet:
    """One of our packets."""
    return Packet(ID_FIRST, com, param, vec)


def commands(**scales: int) -> PlainCommands:
    """The commands of a connection with these scales, 1 for the rest."""
    return PlainCommands(SCALES, PlainSection(**scales), FORCE)


@pytest.mark.parametrize(
    ("com", "ours", "theirs"),
    [
        (
            Com.MOVE_POSE,
            (25_000, -25_050, 0, 45_000, 90_000, -90_250),
            (500, -501, 0, 90, 180, -180),
        ),
        (Com.MOVE_JOINTS, (250, -250, 500, 0, 0, 22_500), (1, -1, 2, 0, 0, 90)),
        (Com.MOVE_BY_JOINTS, (125, 0, 0, 0, 0, 375), (0, 0, 0, 0, 0, 2)),
        (Com.WRENCH, (1_000, -250, 0, 2_000, 0, -1_000), (10, -2, 0, 2, 0, -1)),
        (Com.SPEEDS, FAST, (100, 50, 100, 90, 0, 0)),
    ],
)
def test_numbers_are_counted_in_whole_units_without_scales(com, ours, theirs) -> None:
    """mm, degrees, N, N m, percent and mm/s, rounded to even halves."""
    assert commands().translated(packet(com, 0, ours)) == (Command(com, 0, theirs),)


@pytest.mark.parametrize("com", sorted(COMMANDS - {Com.SET_POINT}))
def test_only_commands_of_the_specification_are_sent(com) -> None:
    """Hello, limits, TCP, heartbeat and set point of force become nothing."""
    for param in TABLE[com].params[:3]:
        made = commands()
        made.translated(packet(Com.MOVE_BY_JOINTS))
        sent = made.translated(packet(com, param))
        assert all(command.com in PLAIN_COMMANDS for command in sent)
        has_counterpart = com in PLAIN_COMMANDS or com == Com.HOLD
        assert bool(sent) == has_counterpart


def test_a_set_point_of_a_stream_is_refused() -> None:
    """It would be a motion of its own."""
    with pytest.raises(LocalProtocolError, match="no command for a stream"):
        commands().translated(packet(Com.SET_POINT))


def test_a_hold_is_a_rotation_by_zero_once_after_a_motion() -> None:
    """Nothing at the start of a connection, at which plain.as has braked."""
    made = commands()
    assert made.translated(packet(Com.HOLD)) == ()
    assert made.after == Status.HELD
    for start in (packet(Com.MOVE_JOINTS), packet(Com.FEEDBACK)):
        made.translated(start)
        assert Status.HELD not in made.after
        assert made.translated(packet(Com.HOLD)) == (STAND_STILL,)
        assert made.after == Status.HELD
        assert made.translated(packet(Com.HOLD)) == ()


def test_force_feedback_runs_at_its_own_speed_and_a_motion_at_the_commanded_one() -> None:
    """Command 5 before the first start, and again before the next motion."""
    made = commands()
    made.translated(packet(Com.SPEEDS, 0, FAST))
    fast = made.translated(packet(Com.SPEEDS, 0, FAST))
    position, orientation = (Command(Com.FEEDBACK, param) for param in (0, 1))
    assert made.translated(packet(Com.FEEDBACK, 0)) == (SLOW, position)
    assert made.translated(packet(Com.FEEDBACK, 1)) == (orientation,)
    assert made.after == Status.POSITION_FEEDBACK | Status.ORIENTATION_FEEDBACK
    assert made.translated(packet(Com.FEEDBACK, 2)) == (Command(Com.FEEDBACK, 2),)
    assert made.after == Status(0)
    goal = made.translated(packet(Com.MOVE_JOINTS))
    assert goal == (*fast, Command(Com.MOVE_JOINTS))
    assert made.translated(packet(Com.MOVE_JOINTS)) == (Command(Com.MOVE_JOINTS),)
    made.translated(packet(Com.FEEDBACK, 0))
    made.translated(packet(Com.SPEEDS, 0, FAST))
    assert made.translated(packet(Com.MOVE_JOINTS)) == (Command(Com.MOVE_JOINTS),)


@pytest.mark.parametrize("end", [(Com.HOLD, 0), (Com.FEEDBACK, 2)])
def test_the_wrench_is_the_error_of_the_set_point(end) -> None:
    """Reading minus set point, which is zero after a hold and a stop."""
    made = commands()
    made.translated(packet(Com.FORCE_SET_POINT, 0, (0, 0, 1_000, 0, 0, 0)))
    reading = packet(Com.WRENCH, 0, (0, 0, 300, 0, 0, 0))
    assert made.translated(reading)[0].vec == (0, 0, -7, 0, 0, 0)
    made.translated(packet(*end))
    assert made.translated(reading)[0].vec == (0, 0, 3, 0, 0, 0)


def integral(force: float, torque: float) -> Packet:
    """Gains in mm/(N s) and deg/(N m s), as our packet."""
    P, I = round(force * GAIN_I), round(torque * GAIN_I)  # noqa: E741 - as in the law
    return packet(Com.GAINS, 1, (P, P, P, I, I, I))


@given(vec=st.tuples(*[st.integers(-40_000, 40_000)] * 6), gain=st.floats(0.01, 20.0))
def test_an_error_moves_no_faster_than_the_cell_file_allows(vec, gain) -> None:
    """I times the error sent is at most 20 mm/s and 28.6 deg/s; a smaller error is unchanged."""
    made = commands(force_per_N=100, torque_per_Nm=1000, gain_i=5000)
    made.translated(integral(gain, gain))
    gain = round(gain * GAIN_I) / GAIN_I  # as sent
    (sent,) = made.translated(packet(Com.WRENCH, 0, vec))
    for first, units, most in ((0, 100, 20.0), (3, 1000, 28.65)):
        parts, ours = sent.vec[first : first + 3], vec[first : first + 3]
        speed = gain * sum((part / units) ** 2 for part in parts) ** 0.5
        asked = gain * sum((part / units) ** 2 for part in ours) ** 0.5
        assert speed <= most + gain * 2.0 / units
        if asked <= most:
            assert parts == ours
        assert all(a * b >= 0 and abs(a) <= abs(b) for a, b in zip(parts, ours, strict=True))


def test_a_gain_that_would_be_sent_as_zero_is_refused_with_the_scale_to_change() -> None:
    """Force feedback that does nothing, or yields on no axis, is no force feedback."""
    both = gains(Gains(force_p_m_per_N=(1e-4,) * 3, force_i_m_per_Ns=(4e-4,) * 3), SCALES)
    for command, field in zip(both, ("gain_p", "gain_i"), strict=True):
        with pytest.raises(LocalProtocolError, match=rf"gateway\.plain\.{field}, 1: .* sent as 0"):
            commands().translated(command.packet(ID_FIRST))
    fine = commands(gain_p=100_000, gain_i=5000)
    assert [fine.translated(each.packet(ID_FIRST))[0].vec[0] for each in both] == [10_000, 2000]


def test_reports_are_converted_back() -> None:
    """Whole mm and degrees to our units; what does not fit is not a pose of this cell."""
    plain = PlainSection()
    pose = Packet(1, Com.POSE, 0, (500, -501, 0, 90, 180, -180))
    assert own_vector(pose, SCALES, plain) == (25_000, -25_050, 0, 45_000, 90_000, -90_000)
    with pytest.raises(RemoteProtocolError, match=r"Y \[mm\] of a report is -2001.*pl\.config"):
        own_vector(Packet(1, Com.POSE, 0, (0, -2001, 0, 0, 0, 0)), SCALES, plain)

"""SI to packet and back: units, signs, carried rounding, and refusal of values out of range."""

from math import degrees, inf, nan, pi, radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from common.motion.frames import Oat, R_from_oat, rotation_between
from controller.packet import Packet, PacketReader, encode
from controller.packet_table import ID_FIRST, CentreParam, Com, Scales, Status, pack_status
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Gains, Joints, Speed
from services.gateway import packets
from services.gateway.packets import Command, ControllerLimits, PoseCarry

SCALES = Scales()
UNIT_MM = 1 / SCALES.position_per_mm
UNIT_DEG = 1 / SCALES.oat_per_deg

position = st.floats(-1.9, 1.9)
angle = st.floats(-pi, pi)
poses = st.builds(
    lambda p, oat: pin.SE3(R_from_oat(Oat(*oat)), np.array(p)),
    st.tuples(position, position, position),
    st.tuples(angle, angle, angle),
)


def over_the_wire(command: Command) -> Packet:
    """Encode and decode a command as the controller would receive it."""
    (packet,) = PacketReader().feed(encode(command.packet(ID_FIRST)))
    return packet


def pose_of(packet: Packet) -> pin.SE3:
    """Return a command's pose as the parser of reports reads it."""
    echoed = Packet(ID_FIRST, Com.POSE, pack_status(0, Status(0)), packet.vec)
    report = packets.parse_report(echoed, SCALES)
    assert isinstance(report, packets.PoseReport)
    return report.T_base_flange


def angle_between_deg(T: pin.SE3, U: pin.SE3) -> float:
    """Return the angle between two orientations in degrees."""
    return degrees(float(np.linalg.norm(rotation_between(T.rotation, U.rotation))))


@given(poses)
def test_a_pose_arrives_within_half_a_unit(T: pin.SE3) -> None:
    """The errors are at most 0.01 mm per axis and the sum of three half angle units."""
    command, _ = packets.pose(Com.MOVE_POSE, T, SCALES, PoseCarry())
    got = pose_of(over_the_wire(command))
    assert np.abs(got.translation - T.translation).max() * 1e3 <= UNIT_MM / 2 + 1e-9
    assert angle_between_deg(got, T) <= 1.5 * UNIT_DEG + 1e-6


@given(st.tuples(position, position, position), st.integers(3, 40))
def test_the_mean_of_a_stream_is_exact(p: tuple[float, float, float], repeats: int) -> None:
    """The rounding error is carried: the sums of sent and target differ by half a unit at most."""
    T, carry, sent_mm = pin.SE3(np.eye(3), np.array(p)), PoseCarry(), np.zeros(3)
    for _ in range(repeats):
        command, carry = packets.pose(Com.MOVE_POSE, T, SCALES, carry)
        sent_mm += pose_of(over_the_wire(command)).translation * 1e3
    assert np.abs(sent_mm - repeats * np.array(p) * 1e3).max() <= UNIT_MM / 2 + 1e-6


@pytest.mark.parametrize("a_deg", [0.0, 180.0])
def test_a_stream_that_comes_to_a_pole_keeps_its_o(a_deg: float) -> None:
    """Only T takes up the freedom at the pole, so the numbers of a tool-down stream do not jump."""
    toward = a_deg + (5.0 if a_deg == 0.0 else -5.0)
    carry, sent_o = PoseCarry(), []
    for a in (toward, a_deg, a_deg, toward):
        R = R_from_oat(Oat(radians(70.0), radians(a), radians(-20.0)))
        command, carry = packets.pose(Com.MOVE_POSE, pin.SE3(R, np.zeros(3)), SCALES, carry)
        sent_o.append(command.vec[3])
    assert sent_o == [70 * SCALES.oat_per_deg] * 4


@given(st.tuples(*[st.floats(-2 * pi, 2 * pi)] * 6))
def test_joint_angles_arrive_within_half_a_unit(q: Joints) -> None:
    """Command 2 and the report of joints have the same unit and sign, for two full turns."""
    packet = over_the_wire(packets.encoded(Com.MOVE_JOINTS, q, SCALES))
    echoed = Packet(ID_FIRST + 5, Com.JOINTS, pack_status(3, Status.MOVING), packet.vec)
    report = packets.parse_report(echoed, SCALES)
    assert isinstance(report, packets.JointReport)
    assert np.degrees(np.abs(np.array(report.joint_rad) - q)).max() <= 0.5 / 250 + 1e-9
    assert (report.framed_id, report.counter) == (ID_FIRST + 5, 3)
    assert report.status == Status.MOVING


def test_each_command_has_the_numbers_of_the_table() -> None:
    """Each command of the PC has the vector that was computed by hand."""
    p = np.array([0.1, -0.2, 0.3])
    T = pin.SE3(R_from_oat(Oat(radians(10), radians(90), radians(-20))), p)
    turn = (radians(1.0), radians(-2.0), 0.0, 0.0, 0.0, radians(90.0))
    gains = Gains(
        force_p_m_per_N=(2e-6, 0.0, 1e-6),
        force_i_m_per_Ns=(1e-4, 0.0, 0.0),
        torque_p_rad_per_Nm=(radians(0.5), 0.0, 0.0),
        torque_i_rad_per_Nms=(0.0, 0.0, radians(0.01)),
    )
    speed = Speed(
        accel_fraction=0.5, decel_fraction=1.0, modular_fraction=0.1, mechanical_m_s=0.25
    )  # fmt: skip
    kept = ControllerLimits(
        step_m=0.002, step_rad=radians(1), speed_m_s=0.05, travel_m=0.1, force_N=60.0,
        watchdog_s=0.25, turn_rad=radians(150.5), torque_Nm=10.0, set_point_m=0.02,
        set_point_rad=radians(6.0), fastest_m_s=0.25, lower_m=(-0.4, 0.2, -0.2),
        upper_m=(0.4, 0.8, 12.0), T_flange_tcp=T, least_segment_s=0.03, least_speed_m_s=0.0012,
        joint_speed_rad_s=tuple(radians(deg) for deg in (370, 310, 410, 550, 550, 1000)),
    )  # fmt: skip
    banks = packets.set_up(kept, SCALES)
    expected = [
        (packets.pose(Com.MOVE_POSE, T, SCALES, PoseCarry())[0],
            (1, 0, (5000, -10000, 15000, 5000, 45000, -10000))),
        (packets.encoded(Com.MOVE_JOINTS, turn, SCALES), (2, 0, (250, -500, 0, 0, 0, 22500))),
        (packets.encoded(Com.MOVE_BY_JOINTS, turn, SCALES), (3, 0, (250, -500, 0, 0, 0, 22500))),
        (packets.wrench((1.0, -2.0, 30.0), (0.1, -0.2, 0.3), SCALES),
            (4, 0, (100, -200, 3000, 100, -200, 300))),
        (packets.speeds(speed, SCALES), (5, 0, (5000, 10000, 1000, 2500, 0, 0))),
        (packets.gains(gains, SCALES)[0], (6, 0, (1000, 0, 500, 250000, 0, 0))),
        (packets.gains(gains, SCALES)[1], (6, 1, (500, 0, 0, 0, 0, 50))),
        (packets.start_feedback("position")[0], (7, 0, (0,) * 6)),
        (packets.start_feedback("orientation")[0], (7, 1, (0,) * 6)),
        (packets.STOP_FEEDBACK, (7, 2, (0,) * 6)),
        (packets.HOLD, (8, 0, (0,) * 6)),
        (packets.hello(SCALES, 7), (9, 3007, (50, 500, 250, 100, 1000, 10))),
        (banks[0], (10, 0, (100, 500, 500, 5000, 6000, 250))),
        (banks[1], (10, 1, (75_250, 10_000, 1000, 3000, 2500, 0))),
        (banks[2], (10, 2, (-20_000, 10_000, -10_000, 0, 0, 0))),
        (banks[3], (10, 3, (20_000, 40_000, 499_999, 0, 0, 0))),
        (banks[4], (10, 4, (30, 12, 0, 0, 0, 0))),
        (banks[5], (10, 5, (92_500, 77_500, 102_500, 137_500, 137_500, 250_000))),
        (banks[6], (11, 0, (5000, -10000, 15000, 5000, 45000, -10000))),
        (packets.tcp(T, SCALES, CentreParam.CENTRE),
            (11, 1, (5000, -10000, 15000, 5000, 45000, -10000))),
        (packets.pose(Com.SET_POINT, T, SCALES, PoseCarry())[0],
            (13, 0, (5000, -10000, 15000, 5000, 45000, -10000))),
        (packets.force_set_point((0.0, -5.0, 30.0), (0.0, 0.5, -1.0), SCALES),
            (14, 0, (0, -500, 3000, 0, 500, -1000)),
        ),
        (packets.HEARTBEAT, (12, 0, (0,) * 6)),
    ]  # fmt: skip
    for command, numbers in expected:
        packet = over_the_wire(command)
        assert (packet.com, packet.param, packet.vec) == numbers
    assert [command.param for command in packets.start_feedback("both")] == [0, 1]
    assert len(banks) == 7
    assert {command.com for command, _ in expected} == set(range(1, 15))


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("index", range(6))
def test_a_number_that_is_not_finite_is_never_sent(bad: float, index: int) -> None:
    """NaN and infinity in any element of any vector raise an error."""
    a, b, c, d, e, f = (bad if i == index else 0.1 for i in range(6))
    with pytest.raises(LocalProtocolError):
        packets.encoded(Com.MOVE_JOINTS, (a, b, c, d, e, f), SCALES)
    with pytest.raises(LocalProtocolError):
        packets.wrench((a, b, c), (d, e, f), SCALES)
    T = pin.SE3(np.eye(3), np.array([bad, 0, 0]))
    with pytest.raises(LocalProtocolError):
        packets.pose(Com.MOVE_POSE, T, SCALES, PoseCarry())
    with pytest.raises(LocalProtocolError):
        packets.tcp(T, SCALES, CentreParam.TCP)
    with pytest.raises(LocalProtocolError):
        packets.pose(Com.MOVE_POSE, T, SCALES, PoseCarry((bad, 0.0, 0.0)))


def test_a_value_out_of_range_is_refused_with_quantity_and_range() -> None:
    """-2.1 m, a joint at 500 degrees, 1500 N with the wrong sign, 200 N m: never clipped."""
    with pytest.raises(
        LocalProtocolError, match=r"Z \[mm\] is -2100, .* holds -1999.98 to 9999.98"
    ):
        packets.pose(Com.MOVE_POSE, pin.SE3(np.eye(3), np.array([0, 0, -2.1])), SCALES, PoseCarry())
    with pytest.raises(LocalProtocolError, match="JT4"):
        packets.encoded(Com.MOVE_JOINTS, (0, 0, 0, -radians(500), 0, 0), SCALES)
    with pytest.raises(LocalProtocolError, match="Fy"):
        packets.wrench((0, -1500.0, 0), (0, 0, 0), SCALES)
    with pytest.raises(LocalProtocolError, match="Mz"):
        packets.wrench((0, 0, 0), (0, 0, -200.0), SCALES)


def test_another_number_of_values_than_the_table_has_is_refused_with_their_names() -> None:
    """A comma in a name of the packet table makes two values of it: the names show it."""
    for values in ((0.1,) * 3, (0.1,) * 5):
        text = rf"command 5 has 4 values \(acceleration; .*; speed\), {len(values)} were given"
        with pytest.raises(LocalProtocolError, match=text):
            packets.encoded(Com.SPEEDS, values, SCALES)


def test_a_gain_is_neither_clipped_nor_lost() -> None:
    """A gain that is too large is refused; one that is too small would be sent as zero."""
    with pytest.raises(LocalProtocolError, match="P gain x"):
        packets.gains(Gains(force_p_m_per_N=(1.1e-3, 0, 0)), SCALES)
    with pytest.raises(LocalProtocolError, match="I gain mz is 1e-09, too small"):
        packets.gains(Gains(torque_i_rad_per_Nms=(0.0, 0.0, 1e-9)), SCALES)


SCALE_ENDS = {
    # The lower end is the coarsest unit that is still useful; the upper one lets this fit into
    # 99 999 units, the largest number of the packet below zero:
    "position_per_mm": (10, 99_999 // 1000),  # 1 m
    "oat_per_deg": (100, 99_999 // 180),
    "joint_per_deg": (50, 99_999 // 360),
    "force_per_N": (1, 99_999 // 100),
    "torque_per_Nm": (10, 99_999 // 10),
    "speed_per_mm_s": (1, 250_000 // 250),  # never negative: 250 mm/s in half of 499 999
}


def scale_ends(name: str) -> tuple[int, int]:
    """Return the lowest and the highest value of a scale."""
    lowest, highest = Scales.model_fields[name].metadata
    return lowest.ge, highest.le


def test_every_scale_has_its_ends_here() -> None:
    """A new scale needs a row."""
    assert {name: scale_ends(name) for name in Scales.model_fields} == SCALE_ENDS
    for name, (low, high) in SCALE_ENDS.items():
        for value in (low - 1, high + 1):
            with pytest.raises(ValidationError, match=name):
                Scales(**{name: value})


def test_the_controllers_hello_must_agree() -> None:
    """Another version, arm or scale is refused; the error names both values and the remedy."""
    good = packets.hello(SCALES, 7).packet(ID_FIRST)
    assert packets.parse_hello(good, SCALES, 7) == packets.HelloReceived()
    for param, message in (
        (1, "protocol 1, this gateway 3: load controller/forcemesh.as"),
        (2007, "protocol 2, this gateway 3: load"),
        (3008, r"arm 8, the cell file's gateway\.arm is 7: are cables .* swapped"),
    ):
        with pytest.raises(RemoteProtocolError, match=message):
            packets.parse_hello(Packet(ID_FIRST, 9, param, good.vec), SCALES, 7)
    with pytest.raises(RemoteProtocolError, match="position_per_mm asked 50, has 60"):
        packets.parse_hello(Packet(ID_FIRST, 9, 3007, (60, *good.vec[1:])), SCALES, 7)
    with pytest.raises(RemoteProtocolError, match="must be hello"):
        packets.parse_hello(Packet(ID_FIRST, 101, 0, good.vec), SCALES, 7)


def test_health_arrives_in_si() -> None:
    """103: error code, loops, wrench age, queue, monitor speed, held ID, any peer."""
    packet = Packet(ID_FIRST, Com.HEALTH, -34024, (123, 45, 2, 3000, 77, 1))
    assert packets.parse_report(packet, SCALES) == packets.HealthReport(
        error_code=-34024,
        loop_count=123,
        wrench_age_s=0.045,
        queue_length=2,
        monitor_speed_fraction=0.3,
        held_id=ID_FIRST + 77,
        any_peer=True,
    )


@pytest.mark.parametrize(
    "packet",
    [
        Packet(ID_FIRST, com, param)
        for com, param in ((1, 0), (12, 0), (9, 1), (105, 0), (0, 0), (101, -1), (102, 499_999))
    ],
)
def test_a_packet_that_no_controller_sends_is_refused(packet: Packet) -> None:
    """Commands of the PC, a second hello, unknown numbers and impossible status are refused."""
    with pytest.raises(RemoteProtocolError):
        packets.parse_report(packet, SCALES)

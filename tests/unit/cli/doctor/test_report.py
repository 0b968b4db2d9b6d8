"""Report of `forcemesh doctor`: its lines for each kind of cell, and its exit codes."""

import numpy as np
import pytest

from cli.context import NO_ANSWER, NOT_WELL, OK
from cli.doctor import verb as doctor
from cli.doctor.checks import ReportLine
from cli.doctor.link import ReceivedReports, Visit
from cli.doctor.remedies import REMEDIES
from cli.doctor.report import (
    CONNECTION_CHECKS,
    REST,
    UNREPORTED,
    ObservedCell,
    bus_lines,
    check_cell,
    link_lines,
    status_of,
    unused_lines,
)
from common.config.cell import CellConfig
from common.config.load import cell_hash, load_cell
from common.motion.kinematics import ArmKinematics
from controller.packet import Packet
from controller.packet_table import ID_FIRST, Com, Status, greeting
from controller.plain import NOT_PROTECTED
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.messages import (
    Health,
    KawasakiStatus,
    LinkHealth,
    RobotState,
    RobotStatus,
    SensorWrench,
)
from services.gateway.connection import robot_status
from services.gateway.packet_window import Spread
from services.gateway.packets import HealthReport, JointReport, PoseReport
from tests.fakes.arms import unknown_arm
from tests.fakes.bench import DEMO
from tests.fuzz.permissive_arbiter import READY as RUNNING

CELLS = DEMO.parent
TCP = load_cell(CELLS / "demo-tcp.yaml")
SIM = load_cell(CELLS / "demo.yaml")
PLAIN = load_cell(CELLS / "demo-plain.yaml", {"bus.endpoint": "tcp/127.0.0.1:1"})
assert TCP.gateway is not None
SECTION, SCALES = TCP.gateway, TCP.gateway
READY = RUNNING | Status.HELD
Q = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
T = ArmKinematics("rs007l").flange_pose(np.array(Q))
STATUS_CHECKS = {
    "motor power", "mode", "teach lock", "robot program", "motion", "position feedback",
    "orientation feedback", "watchdog", "last target", "error lamp", "held",
}  # fmt: skip
PROCESSES = {f"process {role}" for role in topics.ROLES}
NUMBERS = {
    "framed_round_trip_p50_s": 0.02, "framed_round_trip_p99_s": 0.04, "sender_hz": 40.0,
    "program_loop_hz": 2.0, "monitor_speed_fraction": 1.0, "any_peer_may_connect": 0.0,
}  # fmt: skip


def good_reports(status: Status = READY) -> ReceivedReports:
    """Return the reports of a healthy controller."""
    return ReceivedReports(
        pose=PoseReport(T, 0, 1, status),
        joints=JointReport(Q, 1, 1, status),
        health=HealthReport(0, 100, 0.0, 0, 1.0, 1, any_peer=False),
        sender_hz=40.0,
        longest_gap_s=0.03,
        loop_hz=12.0,
        round_trip=Spread(0.02, 0.04),
        held=True,
    )


def a_visit(found: ReceivedReports | None) -> Visit:
    """Return a visit with a correct greeting."""
    hello = Packet(ID_FIRST, Com.HELLO, greeting(1), SCALES.vec)
    return Visit(hello_outcome="answered", hello=hello, reports=found)


def words(lines: list[ReportLine]) -> dict[str, str]:
    """Return the result of each line; a check has one line."""
    assert len({line.check for line in lines}) == len(lines)
    return {line.check: line.result for line in lines}


def a_state(**changes: object) -> RobotState:
    """Return the state of a healthy robot."""
    quaternion = tuple(float(x) for x in _xyzw())
    bits = KawasakiStatus(
        motor_power=True, repeat_mode=True, teach_lock_off=True, program_running=True
    )
    status = RobotStatus(ready=True, held=True, kawasaki=bits)
    state = RobotState(
        position_m=tuple(float(x) for x in T.translation),  # type: ignore[arg-type]
        orientation_xyzw=quaternion,  # type: ignore[arg-type]
        joint_rad=Q,
        status=status,
        link=LinkHealth(connected=True),
    )
    return state.replaced(**changes)


def _xyzw() -> np.ndarray:
    import pinocchio as pin  # noqa: PLC0415 - for this line alone

    return pin.Quaternion(T.rotation).coeffs()


def observed(cell: CellConfig, state: RobotState | None, numbers: dict[str, float]) -> ObservedCell:
    """Return the observation of a healthy bus."""
    streams = ("robot/state", "sensor/wrench", "wrench", "regulator/target", "robot/command")
    rates = {row.key: cell.rate_hz(row) for row in topics.TOPICS}
    well = Reading(Health(rate_hz=250.0, config_hash=cell_hash(cell)), None, 0.1, "")
    roles = dict.fromkeys(topics.ROLES, well)
    return ObservedCell(roles, Health(numbers=numbers), state, {key: rates[key] for key in streams})


def test_a_healthy_controller_passes_every_line() -> None:
    """Connection, sender, status bits, codes, pose, loop, speeds, round trip and goodbye pass."""
    lines = words(link_lines(TCP, SECTION, a_visit(good_reports())))
    assert set(lines) == {*CONNECTION_CHECKS, *REST, *STATUS_CHECKS} - {"status bits"}
    assert set(lines.values()) == {"PASS"}


VISITS = {
    "closed port": (Visit(opened="refused"), "address", NO_ANSWER),
    "silent": (Visit(hello_outcome="silent"), "hello", NO_ANSWER),
    "garbled": (Visit(hello_outcome="garbled"), "hello", NO_ANSWER),
    "version": (
        Visit(hello_outcome="answered", hello=Packet(ID_FIRST, 9, 2001, SCALES.vec)),
        "protocol",
        NOT_WELL,
    ),
    "scales": (
        Visit(
            hello_outcome="answered",
            hello=Packet(ID_FIRST, 9, greeting(1), (60, 500, 250, 100, 1000, 10)),
        ),
        "scales", NOT_WELL,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", VISITS)
def test_checks_after_a_failed_one_are_skipped_by_name(name: str) -> None:
    """One line fails; the later ones are marked as skipped."""
    found, failing, code = VISITS[name]
    lines = link_lines(TCP, SECTION, found)
    marks = words(lines)
    assert [check for check, word in marks.items() if word == "FAIL"] == [failing]
    assert {*CONNECTION_CHECKS, *REST} == set(marks)
    assert all(marks[check] == "SKIP" for check in REST)
    assert all(line.found for line in lines)
    assert doctor.exit_code(lines) == code


def test_a_broken_connection_is_reported_with_the_earlier_reports() -> None:
    """Reports received before the break are still judged."""
    broken = good_reports()
    broken.broken, broken.held = "closed by the controller", False
    lines = link_lines(TCP, SECTION, a_visit(broken))
    marks = words(lines)
    assert marks["connection"] == "FAIL"
    assert {line.remedy for line in lines if line.result == "FAIL"} == {REMEDIES["reports.broken"]}
    assert (marks["left behind"], marks["pose"]) == ("WARN", "PASS")
    assert doctor.exit_code(lines) == NOT_WELL


def test_what_is_missing_or_moving_is_not_judged_as_good() -> None:
    """No report, a moving arm, an arm without a model, numbers that are not known yet."""
    none = words(link_lines(TCP, SECTION, a_visit(ReceivedReports())))
    assert (none["sender"], none["status bits"], none["pose"]) == ("FAIL", "SKIP", "SKIP")
    moving = words(link_lines(TCP, SECTION, a_visit(good_reports(READY | Status.MOVING))))
    assert moving["pose"] == "WARN"  # AS reads pose and joints one after the other
    assert words(link_lines(unknown_arm(), SECTION, a_visit(good_reports())))["pose"] == "SKIP"
    unknown = words(bus_lines(TCP, observed(TCP, a_state(), {})))
    assert (unknown["round trip"], unknown["program loop"]) == ("SKIP", "WARN")
    assert (unknown["sender"], unknown["monitor speed"]) == ("FAIL", "WARN")


def test_monitor_speed_and_loop_delay_are_compared_with_the_measured_ones() -> None:
    """On the link and on the bus alike; without a measurement of the delay there is no line."""
    assert words(link_lines(TCP, SECTION, a_visit(good_reports()), 50.0))["monitor speed"] == "WARN"
    bus = observed(TCP, a_state(), NUMBERS | {"monitor_speed_fraction": 0.5})
    marks = words(bus_lines(TCP, bus, 100.0))
    assert (marks["monitor speed"], "loop delay" in marks) == ("FAIL", False)
    for excess_s, result in ((0.0, "PASS"), (0.1, "WARN")):
        numbers = {"loop_delay_s": TCP.loop_delay_s + excess_s}
        health = Health(rate_hz=250.0, config_hash=cell_hash(TCP), numbers=numbers)
        bus.roles = {**bus.roles, "regulator": Reading(health, None, 0.1, "")}
        assert words(bus_lines(TCP, bus))["loop delay"] == result


def test_a_running_cell_is_observed_on_the_bus() -> None:
    """Roles, topics, bits and numbers are judged; the connection belongs to the gateway."""
    lines = bus_lines(TCP, observed(TCP, a_state(), NUMBERS))
    marks = words(lines)
    assert {check for check, word in marks.items() if word == "SKIP"} == {
        *CONNECTION_CHECKS,
        "left behind",
    }
    assert set(marks.values()) == {"PASS", "SKIP"}
    assert {*PROCESSES, *STATUS_CHECKS, "link", "robot/state"} <= set(marks)
    assert doctor.exit_code(lines) == OK


@pytest.mark.parametrize(("serial", "result"), [("FT1", "PASS"), ("", "WARN")])
def test_a_sensor_without_a_serial_number_is_reported(serial: str, result: str) -> None:
    """Its calibration could be that of another one; a simulated sensor has no such line."""
    found = observed(TCP, a_state(), NUMBERS)
    found.sensor = SensorWrench(serial=serial)
    assert "sensor serial" not in words(bus_lines(TCP, found))
    roles = TCP.roles.model_copy(update={"sensor": "driver"})
    cell = TCP.model_copy(update={"roles": roles})
    assert words(bus_lines(cell, found))["sensor serial"] == result


def test_protocol_plain_warns_of_the_protection_that_it_gives_up() -> None:
    """What it does not report is skipped, whether the cell is up or not; the rest is judged."""
    lines = bus_lines(PLAIN, observed(PLAIN, a_state(), NUMBERS))
    marks = words(lines)
    warnings = [line for line in lines if line.check.startswith("protection ")]
    assert [line.found for line in warnings] == [f"without {row}" for row in NOT_PROTECTED]
    assert [bool(line.remedy) for line in warnings] == [*[False] * (len(warnings) - 1), True]
    assert {marks[check] for check in (*UNREPORTED, *CONNECTION_CHECKS)} == {"SKIP"}
    assert (marks["protection 1"], marks["pose"], marks["sender"]) == ("WARN", "PASS", "PASS")
    assert not STATUS_CHECKS & set(marks)
    down = words(check_cell(PLAIN))
    assert down["protection 1"] == "WARN"
    assert {down[check] for check in (*CONNECTION_CHECKS, *REST)} == {"SKIP"}


LOST = {
    "silent": None,
    "not valid": a_state(valid=False, reason="controller 192.168.0.2:49152: no answer"),
    "not connected": a_state(link=LinkHealth()),
}


@pytest.mark.parametrize("name", LOST)
def test_a_gateway_without_its_controller_fails_the_link(name: str) -> None:
    """The link line has the gateway's reason; the other checks are skipped."""
    state = LOST[name]
    lines = bus_lines(TCP, observed(TCP, state, {}))
    (link,) = (line for line in lines if line.check == "link")
    assert (link.result, link.remedy) == ("FAIL", REMEDIES["link"])
    assert name != "not valid" or "no answer" in link.found
    assert all(line.result == "SKIP" for line in lines if line.check in REST)
    assert doctor.exit_code(lines) == NOT_WELL


def test_a_simulated_cell_has_no_link() -> None:
    """Roles, topics and the pose are judged; checks of a controller are skipped with a reason."""
    marks = words(bus_lines(SIM, observed(SIM, a_state(), {})))
    assert {check for check, word in marks.items() if word == "SKIP"} == {
        *CONNECTION_CHECKS,
        *REST,
    } - {"pose"}
    assert marks["pose"] == "PASS"
    assert {line.found for line in unused_lines(SIM)} == {
        "not used by this cell: roles.robot is sim"
    }
    silent = words(bus_lines(SIM, observed(SIM, None, {})))
    assert silent["pose"] == "SKIP"


def test_a_decimated_robot_state_is_not_slow_but_one_at_half_rate_is() -> None:
    """At 73 reports/s the gateway publishes each second one: 36.5/s instead of 40."""
    found = observed(TCP, a_state(), NUMBERS)
    for hz, word in ((36.5, "PASS"), (20.0, "WARN"), (None, "FAIL")):
        found.stream_hz["robot/state"] = hz
        assert words(bus_lines(TCP, found))["robot/state"] == word
    simulated = observed(SIM, a_state(), {})
    simulated.stream_hz["robot/state"] = 200.0
    assert words(bus_lines(SIM, simulated))["robot/state"] == "WARN"


@pytest.mark.parametrize("bit", list(Status), ids=lambda bit: bit.name)
def test_the_status_of_a_robot_is_that_of_its_controller(bit: Status) -> None:
    """Each bit of the packet is in robot/state and round trips."""
    assert status_of(robot_status(bit, 0)) == bit


def test_the_text_report_has_a_remedy_below_each_failure(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Square brackets are printed as text; the last line counts the results."""
    doctor.print_lines(
        [ReportLine("a", "PASS", "fine"), ReportLine("b b", "FAIL", "bad [x]", "do [y]")]
    )
    assert capsys.readouterr().out.splitlines() == [
        "PASS  a    fine",
        "FAIL  b b  bad [x]",
        "           -> do [y]",
        "1 passed, 0 warnings, 1 failed, 0 skipped",
    ]

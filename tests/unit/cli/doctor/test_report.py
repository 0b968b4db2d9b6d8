"""What `forcemesh doctor` looks at in which cell, and its exit codes: nothing is left out."""

from pathlib import Path

import numpy as np
import pytest

from cli.context import NO_ANSWER, NOT_WELL, OK, USAGE
from cli.doctor import verb as doctor
from cli.doctor.bus import ObservedCell
from cli.doctor.checks import ObservedRole, ReportLine, finding
from cli.doctor.link import ReceivedReports, Visit
from cli.doctor.remedies import REMEDIES
from cli.doctor.report import (
    CONNECTION_CHECKS,
    REST,
    bus_lines,
    link_lines,
    status_of,
    unused_lines,
)
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.kinematics import ArmKinematics
from controller.packet import Packet
from controller.packet_table import ID_FIRST, Com, Status, greeting
from forcemesh import topics
from forcemesh.messages import Health, KawasakiStatus, LinkHealth, RobotState, RobotStatus
from services.gateway.reports import HealthReport, JointReport, PoseReport
from services.gateway.round_trips import Spread
from services.gateway.service import robot_status, scales_of

CELLS = Path(__file__).resolve().parents[4] / "cells"
TCP = load_cell(CELLS / "demo-tcp.yaml")
SIM = load_cell(CELLS / "demo.yaml")
assert TCP.gateway is not None
SECTION, SCALES = TCP.gateway, scales_of(TCP.gateway)
READY = (
    Status.MOTOR_POWER | Status.REPEAT_MODE | Status.TEACH_LOCK_OFF | Status.PROGRAM_RUNNING
    | Status.HELD
)  # fmt: skip
Q = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
T = ArmKinematics().flange_pose(np.array(Q))
STATUS_CHECKS = {
    "motor power", "mode", "teach lock", "robot program", "motion", "position feedback",
    "orientation feedback", "watchdog", "last target", "error lamp", "held",
}  # fmt: skip
PROCESSES = {f"process {role}" for role in topics.ROLES}
NUMBERS = {
    "framed_round_trip_p50_s": 0.02, "framed_round_trip_p99_s": 0.04, "sender_hz": 40.0,
    "program_loop_hz": 2.0, "monitor_speed_fraction": 1.0, "any_peer_may_connect": 0.0,
}  # fmt: skip


def heard(status: Status = READY) -> ReceivedReports:
    """What a controller in good order says."""
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
    """A visit that was greeted well."""
    hello = Packet(ID_FIRST, Com.HELLO, greeting(1), SCALES.vec)
    return Visit(hello_outcome="answered", hello=hello, reports=found)


def words(lines: list[ReportLine]) -> dict[str, str]:
    """The word of each line; a check has one line."""
    assert len({line.check for line in lines}) == len(lines)
    return {line.check: line.result for line in lines}


def a_state(**changes: object) -> RobotState:
    """The state of a robot in good order."""
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
    return state.model_copy(update=changes)


def _xyzw() -> np.ndarray:
    import pinocchio as pin  # noqa: PLC0415 - for this line alone

    return pin.Quaternion(T.rotation).coeffs()


def overheard(
    cell: CellConfig, state: RobotState | None, numbers: dict[str, float]
) -> ObservedCell:
    """A bus in good order."""
    streams = ("robot/state", "sensor/wrench", "wrench", "regulator/target", "robot/command")
    rates = {row.key: cell.rate_hz(row) for row in topics.TOPICS}
    roles = [ObservedRole(role, 0.1, is_fresh=True, rate_hz=250.0) for role in topics.ROLES]
    return ObservedCell(roles, Health(numbers=numbers), state, {key: rates[key] for key in streams})


def test_a_controller_in_good_order_passes_every_line() -> None:
    """Way, sender, eleven bits, codes, pose, loop, speeds, round trip, goodbye."""
    lines = words(link_lines(TCP, SECTION, SCALES, a_visit(heard())))
    assert set(lines) == {*CONNECTION_CHECKS, *REST, *STATUS_CHECKS} - {"status bits"}
    assert set(lines.values()) == {"PASS"}


VISITS = {
    "closed port": (Visit(opened="refused"), "address", NO_ANSWER),
    "mute": (Visit(hello_outcome="silent"), "hello", NO_ANSWER),
    "garbled": (Visit(hello_outcome="garbled"), "hello", NO_ANSWER),
    "version": (
        Visit(hello_outcome="answered", hello=Packet(ID_FIRST, 9, 3001, SCALES.vec)),
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
def test_what_was_not_reached_is_skipped_by_name(name: str) -> None:
    """One line fails, everything behind it says that it was not tried."""
    found, failing, code = VISITS[name]
    lines = link_lines(TCP, SECTION, SCALES, found)
    marks = words(lines)
    assert [check for check, word in marks.items() if word == "FAIL"] == [failing]
    assert {*CONNECTION_CHECKS, *REST} == set(marks)
    assert all(marks[check] == "SKIP" for check in REST)
    assert all(line.found for line in lines)
    assert doctor.exit_code(lines) == code


def test_a_connection_that_breaks_is_said_beside_what_was_heard() -> None:
    """What came before is judged all the same."""
    broken = heard()
    broken.broken, broken.held = "closed by the controller", False
    lines = link_lines(TCP, SECTION, SCALES, a_visit(broken))
    marks = words(lines)
    assert marks["connection"] == "FAIL"
    assert {line.remedy for line in lines if line.result == "FAIL"} == {REMEDIES["reports.broken"]}
    assert (marks["left behind"], marks["pose"]) == ("WARN", "PASS")
    assert doctor.exit_code(lines) == NOT_WELL


def test_a_greeted_controller_without_reports_has_no_bits_and_no_pose() -> None:
    """They are skipped with the reason, the sender fails."""
    marks = words(link_lines(TCP, SECTION, SCALES, a_visit(ReceivedReports())))
    assert (marks["sender"], marks["status bits"], marks["pose"]) == ("FAIL", "SKIP", "SKIP")
    assert (marks["error code"], marks["round trip"]) == ("WARN", "FAIL")


def test_a_pose_is_not_compared_while_the_arm_moves() -> None:
    """101 and 102 are of one sample, but AS reads pose and joints one after the other."""
    lines = link_lines(TCP, SECTION, SCALES, a_visit(heard(READY | Status.MOVING)))
    (pose,) = (line for line in lines if line.check == "pose")
    assert (pose.result, pose.remedy) == ("WARN", REMEDIES["pose.moving"])


def test_an_arm_without_a_model_has_no_pose_check() -> None:
    """It is skipped and said, not failed."""
    other = load_cell(CELLS / "demo-tcp.yaml", {"robot.joint_max_deg": [90] * 6})
    assert words(link_lines(other, SECTION, SCALES, a_visit(heard())))["pose"] == "SKIP"


def test_a_running_cell_is_asked_on_the_bus() -> None:
    """Roles, topics, bits, numbers; the way to the controller is the gateway's."""
    lines = bus_lines(TCP, SCALES, overheard(TCP, a_state(), NUMBERS))
    marks = words(lines)
    assert {check for check, word in marks.items() if word == "SKIP"} == {
        *CONNECTION_CHECKS,
        "left behind",
    }
    assert set(marks.values()) == {"PASS", "SKIP"}
    assert {*PROCESSES, *STATUS_CHECKS, "link", "robot/state"} <= set(marks)
    assert doctor.exit_code(lines) == OK


def test_numbers_that_are_not_known_are_not_made_up() -> None:
    """No round trip while nothing was sent; no rates right after the connection."""
    marks = words(bus_lines(TCP, SCALES, overheard(TCP, a_state(), {})))
    assert (marks["round trip"], marks["program loop"]) == ("SKIP", "WARN")
    assert (marks["sender"], marks["monitor speed"]) == ("FAIL", "WARN")


LOST = {
    "silent": None,
    "not valid": a_state(valid=False, reason="controller 192.168.0.2:49152: no answer"),
    "not connected": a_state(link=LinkHealth()),
}


@pytest.mark.parametrize("name", LOST)
def test_a_gateway_without_its_controller_fails_the_link(name: str) -> None:
    """With the gateway's own reason; the rest is skipped, not guessed."""
    state = LOST[name]
    lines = bus_lines(TCP, SCALES, overheard(TCP, state, {}))
    (link,) = (line for line in lines if line.check == "link")
    assert (link.result, link.remedy) == ("FAIL", REMEDIES["link"])
    assert name != "not valid" or "no answer" in link.found
    assert all(line.result == "SKIP" for line in lines if line.check in REST)
    assert doctor.exit_code(lines) == NOT_WELL


def test_a_simulated_cell_has_no_link_and_says_so() -> None:
    """Roles, topics and the pose are judged, everything of a controller is not used."""
    marks = words(bus_lines(SIM, SCALES, overheard(SIM, a_state(), {})))
    assert {check for check, word in marks.items() if word == "SKIP"} == {
        *CONNECTION_CHECKS,
        *REST,
    } - {"pose"}
    assert marks["pose"] == "PASS"
    assert {line.found for line in unused_lines(SIM)} == {
        "not used by this cell: roles.robot is sim"
    }
    silent = words(bus_lines(SIM, SCALES, overheard(SIM, None, {})))
    assert silent["pose"] == "SKIP"


def test_a_thinned_robot_state_is_not_slow_but_one_at_half_is() -> None:
    """Of a sender at 73/s the gateway passes on each second sample: 36.5/s for 40."""
    found = overheard(TCP, a_state(), NUMBERS)
    for hz, word in ((36.5, "PASS"), (20.0, "WARN"), (None, "FAIL")):
        found.stream_hz["robot/state"] = hz
        assert words(bus_lines(TCP, SCALES, found))["robot/state"] == word
    simulated = overheard(SIM, a_state(), {})
    simulated.stream_hz["robot/state"] = 200.0
    assert words(bus_lines(SIM, SCALES, simulated))["robot/state"] == "WARN"


@pytest.mark.parametrize("bit", list(Status), ids=lambda bit: bit.name)
def test_the_status_of_a_robot_is_that_of_its_controller(bit: Status) -> None:
    """Each bit of the packet is in robot/state, and comes back from it as it was."""
    assert status_of(robot_status(bit, 0, ())) == bit


def test_exit_codes() -> None:
    """0 with warnings, 1 with a failure, 2 for a cell file, 4 when nobody is there."""
    line, fail = ReportLine("x", "PASS", "fine"), ReportLine("x", "FAIL", "bad", "do")
    assert (
        doctor.exit_code(
            [line, ReportLine("y", "WARN", "hm", "do"), ReportLine("z", "SKIP", "why")]
        )
        == OK
    )
    assert doctor.exit_code([line, fail]) == NOT_WELL
    assert doctor.exit_code([finding("cell file", "FAIL", "m", "cell file"), fail]) == USAGE
    for check in ("address", "hello", "bus"):
        assert doctor.exit_code([fail, ReportLine(check, "FAIL", "bad", "do")]) == NO_ANSWER


def test_the_report_for_people_has_a_remedy_below_each_trouble(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Square brackets in what was found are text; the last line counts."""
    doctor.print_lines(
        [ReportLine("a", "PASS", "fine"), ReportLine("b b", "FAIL", "bad [x]", "do [y]")]
    )
    assert capsys.readouterr().out.splitlines() == [
        "PASS  a    fine",
        "FAIL  b b  bad [x]",
        "           -> do [y]",
        "1 passed, 0 warnings, 1 failed, 0 skipped",
    ]

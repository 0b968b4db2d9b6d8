"""`forcemesh doctor`: lines and exit codes for each kind of cell, and its choice of link or bus."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.context import NO_ANSWER, NOT_WELL, OK, USAGE
from cli.doctor import link as doctor_link
from cli.doctor import verb as doctor
from cli.doctor.checks import ReportLine
from cli.doctor.link import ReceivedReports, Visit, VisitTimeouts
from cli.doctor.remedies import REMEDIES
from cli.doctor.report import (
    CONNECTION_CHECKS,
    REST,
    UNREPORTED,
    ObservedCell,
    bus_lines,
    check_cell,
    link_lines,
    observe_cell,
    status_of,
)
from common.bus.cell_bus import open_hub
from common.config.cell import CellConfig
from common.config.load import cell_hash, dump_cell, load_cell
from common.motion.convert import record_of
from common.motion.kinematics import ArmKinematics
from controller.packet import Packet
from controller.packet_table import ID_FIRST, Com, Status, greeting
from controller.plain import NOT_PROTECTED
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.messages import Health, KawasakiStatus, LinkHealth, RobotState, RobotStatus
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.run_file import FOLDER_VARIABLE, new_run
from services.gateway.connection import robot_status
from services.gateway.packet_window import Spread
from services.gateway.packets import HealthReport, JointReport, PoseReport
from sim.controller.behaviour import Behaviour
from sim.controller.network import SocketNetwork
from tests.chaos.common_net import free_port
from tests.fakes.arms import unknown_arm
from tests.fakes.bench import DEMO
from tests.fakes.controller import RunningController
from tests.fakes.controller_talk import TEXT
from tests.fuzz.permissive_arbiter import READY as RUNNING
from tools.tree import ROOT

CELLS = DEMO.parent
TCP = load_cell(CELLS / "demo-tcp.yaml")


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
    pose = record_of(T)
    bits = KawasakiStatus(
        motor_power=True, repeat_mode=True, teach_lock_off=True, program_running=True
    )
    status = RobotStatus(ready=True, held=True, kawasaki=bits)
    state = RobotState(
        position_m=pose.position_m,
        orientation_xyzw=pose.orientation_xyzw,
        joint_rad=Q,
        status=status,
        link=LinkHealth(connected=True),
    )
    return state.replaced(**changes)


def observed(cell: CellConfig, state: RobotState | None, numbers: dict[str, float]) -> ObservedCell:
    """Return the observation of a healthy bus."""
    streams = ("robot/state", "sensor/wrench", "wrench", "regulator/target", "robot/command")
    rates = {row.key: cell.rate_hz(row) for row in topics.TOPICS}
    well = Reading(Health(rate_hz=250.0, config_hash=cell_hash(cell)), None, 0.1, "")
    roles = dict.fromkeys(topics.ROLES, well)
    return ObservedCell(roles, Health(numbers=numbers), state, {key: rates[key] for key in streams})


def greeted(number: int, scales: Any = SCALES.vec) -> Visit:
    """Return a visit whose greeting has these numbers."""
    return Visit(hello_outcome="answered", hello=Packet(ID_FIRST, Com.HELLO, number, scales))


@pytest.mark.parametrize(
    ("found", "failing", "code"),
    [
        (Visit(opened="refused"), "address", NO_ANSWER),
        (Visit(hello_outcome="silent"), "hello", NO_ANSWER),
        (greeted(2001), "protocol", NOT_WELL),
        (greeted(greeting(1), (60, 500, 250, 100, 1000, 10)), "scales", NOT_WELL),
    ],
)
def test_checks_after_a_failed_one_are_skipped_by_name(
    found: Visit, failing: str, code: int
) -> None:
    """One line fails; the later ones are marked as skipped."""
    lines = link_lines(TCP, SECTION, found)
    marks = words(lines)
    assert [check for check, word in marks.items() if word == "FAIL"] == [failing]
    assert {*CONNECTION_CHECKS, *REST} == set(marks)
    assert all(marks[check] == "SKIP" for check in REST)
    assert all(line.found for line in lines)
    assert doctor.exit_code(lines) == code


def test_what_is_broken_missing_or_moving_is_not_judged_as_good() -> None:
    """Reports received before a break are still judged; what is not known yet is no PASS."""
    broken = good_reports()
    broken.broken, broken.held = "closed by the controller", False
    lines = link_lines(TCP, SECTION, a_visit(broken))
    marks = words(lines)
    assert (marks["connection"], marks["left behind"], marks["pose"]) == ("FAIL", "WARN", "PASS")
    assert {line.remedy for line in lines if line.result == "FAIL"} == {REMEDIES["reports.broken"]}
    assert doctor.exit_code(lines) == NOT_WELL
    none = words(link_lines(TCP, SECTION, a_visit(ReceivedReports())))
    assert (none["sender"], none["status bits"], none["pose"]) == ("FAIL", "SKIP", "SKIP")
    moving = words(link_lines(TCP, SECTION, a_visit(good_reports(READY | Status.MOVING))))
    assert moving["pose"] == "WARN"  # AS reads pose and joints one after the other
    assert words(link_lines(unknown_arm(), SECTION, a_visit(good_reports())))["pose"] == "SKIP"
    unknown = words(bus_lines(TCP, observed(TCP, a_state(), {})))
    assert (unknown["round trip"], unknown["program loop"]) == ("SKIP", "WARN")
    assert (unknown["sender"], unknown["monitor speed"]) == ("FAIL", "WARN")


def test_a_running_cell_is_observed_on_the_bus() -> None:
    """Roles, topics, bits and numbers are judged; the connection belongs to the gateway."""
    found = observed(TCP, a_state(), NUMBERS)
    lines = bus_lines(TCP, found)
    marks = words(lines)
    skipped = {check for check, word in marks.items() if word == "SKIP"}
    assert skipped == {*CONNECTION_CHECKS, "left behind"}
    assert set(marks.values()) == {"PASS", "SKIP"}
    assert {*PROCESSES, *STATUS_CHECKS, "link", "robot/state"} <= set(marks)
    assert doctor.exit_code(lines) == OK
    # At 73 reports/s the gateway publishes each second one: 36.5/s instead of 40.
    for hz, word in ((36.5, "PASS"), (20.0, "WARN"), (None, "FAIL")):
        found.stream_hz["robot/state"] = hz
        assert words(bus_lines(TCP, found))["robot/state"] == word


def test_protocol_plain_warns_of_the_protection_that_it_gives_up() -> None:
    """What it does not report is skipped, whether the cell is up or not; the rest is judged."""
    lines = bus_lines(PLAIN, observed(PLAIN, a_state(), NUMBERS))
    marks = words(lines)
    warnings = [line for line in lines if line.check.startswith("protection ")]
    assert [line.found for line in warnings] == [f"without {row}" for row in NOT_PROTECTED]
    assert [bool(line.remedy) for line in warnings] == [*[False] * (len(warnings) - 1), True]
    assert {marks[check] for check in (*UNREPORTED, *CONNECTION_CHECKS)} == {"SKIP"}
    assert (marks["pose"], marks["sender"]) == ("PASS", "PASS")
    assert not STATUS_CHECKS & set(marks)
    down = words(check_cell(PLAIN))
    assert down["protection 1"] == "WARN"
    assert {down[check] for check in (*CONNECTION_CHECKS, *REST)} == {"SKIP"}


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        (None, ""),
        (a_state(valid=False, reason="controller 192.168.0.2:49152: no answer"), "no answer"),
        (a_state(link=LinkHealth()), ""),
    ],
)
def test_a_gateway_without_its_controller_fails_the_link(
    state: RobotState | None, reason: str
) -> None:
    """The link line has the gateway's reason; the other checks are skipped."""
    lines = bus_lines(TCP, observed(TCP, state, {}))
    (link,) = (line for line in lines if line.check == "link")
    assert (link.result, link.remedy) == ("FAIL", REMEDIES["link"])
    assert reason in link.found
    assert all(line.result == "SKIP" for line in lines if line.check in REST)
    assert doctor.exit_code(lines) == NOT_WELL


@pytest.mark.parametrize("bit", list(Status), ids=lambda bit: bit.name)
def test_the_status_of_a_robot_is_that_of_its_controller(bit: Status) -> None:
    """Each bit of the packet is in robot/state and round trips."""
    assert status_of(robot_status(bit, 0)) == bit


SHORT = VisitTimeouts(connect_s=0.5, hello_s=0.5, reports_s=0.5, watch_s=1.2, confirm_s=0.5)


@pytest.fixture
def cell_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """A function that makes a cell file on free ports, without a running cell."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.delenv(ENDPOINT_VARIABLE, raising=False)
    monkeypatch.setattr(doctor_link, "PATIENCE", SHORT)

    def make(port: int = 0, base: str = "demo-tcp") -> Path:
        changes: dict[str, object] = {
            "cell": "doctor", "bus.endpoint": f"tcp/127.0.0.1:{free_port()}"
        }  # fmt: skip
        if port:
            changes |= {"gateway.port": port, "gateway.position_per_mm": 50}
        path = tmp_path / "cell.yaml"
        path.write_text(dump_cell(load_cell(ROOT / "cells" / f"{base}.yaml", changes)))
        return path

    return make


def run(path: Path) -> tuple[int, dict[str, str]]:
    """Run the verb; return its exit code and the result of each line."""
    result = CliRunner().invoke(app, ["doctor", "--json", "--cell", str(path)])
    report = json.loads(result.stdout)
    assert report["exit_code"] == result.exit_code
    return result.exit_code, {line["check"]: line["result"] for line in report["lines"]}


def served() -> RunningController:
    """Return a controller with the shipped program, on a socket."""
    return RunningController(TEXT, behaviour=Behaviour(), network=SocketNetwork(port=0))


@pytest.mark.realtime
def test_a_healthy_controller_is_exit_code_0(cell_file: Callable[..., Path]) -> None:
    """The fake arm has the model's lengths: pose and joints agree."""
    with served() as controller:
        code, words = run(cell_file(controller.port))
    assert code == OK
    assert {check for check, word in words.items() if word == "SKIP"} == {
        "processes",
        "zenoh",
        "sensor",
    }
    assert "FAIL" not in words.values()
    assert words["pose"] == "PASS"


def test_a_cell_file_with_a_mistake_is_exit_code_2(tmp_path: Path) -> None:
    """There is only the line of the cell file; no other check runs."""
    path = tmp_path / "cell.yaml"
    path.write_text("cell: 7\n")
    assert run(path) == (USAGE, {"cell file": "FAIL"})


@pytest.mark.realtime
def test_no_reply_is_exit_code_4(cell_file: Callable[..., Path]) -> None:
    """A closed port, and a simulated cell that is not up; a named probe has its rows."""
    path = cell_file(free_port())
    (path.parent / "probe.yaml").write_text("results: {switch.qtool: {value: -1}}\n")
    path.write_text(path.read_text().replace("\nrobot:\n", "\nrobot:\n  probe: probe.yaml\n"))
    code, words = run(path)
    assert (words["QTOOL"], words["probe"]) == ("WARN", "WARN")
    assert (code, words["address"], words["pose"]) == (NO_ANSWER, "FAIL", "SKIP")
    code, words = run(cell_file(base="demo"))
    assert (code, words["bus"], words["address"]) == (NO_ANSWER, "FAIL", "SKIP")


@pytest.mark.realtime
def test_while_the_cell_is_up_the_controller_is_not_contacted(
    cell_file: Callable[..., Path],
) -> None:
    """With the run file of a live supervisor there is no second client, even without a hub."""
    with served() as controller:
        path = cell_file(controller.port)
        new_run(load_cell(path), path).write()  # this test is the supervisor
        code, words = run(path)
        assert (code, words["bus"], "address" in words) == (NO_ANSWER, "FAIL", False)
        assert controller.machine.tcp.sockets == ()


@pytest.mark.realtime
def test_a_running_cell_is_observed_on_its_bus(cell_file: Callable[..., Path]) -> None:
    """Without a run file the publisher of robot/health reveals that the controller is in use."""
    ready, stop = threading.Event(), threading.Event()

    def publish() -> None:
        with open_hub(cell) as hub:
            ready.set()
            robot = hub.playing("robot")
            health = robot.publisher(topics.HEALTH["robot"])
            state = robot.publisher(topics.ROBOT_STATE)
            while not stop.wait(0.02):
                health.put(Health(config_hash=cell_hash(cell), numbers={"sender_hz": 40.0}))
                state.put(RobotState())

    with served() as controller:
        path = cell_file(controller.port)
        cell = load_cell(path)
        thread = threading.Thread(target=publish)
        thread.start()
        try:
            assert ready.wait(20.0)
            found = observe_cell(cell, watch_s=1.0)
            code, words = run(path)
        finally:
            stop.set()
            thread.join()
        assert found is not None
        assert found.robot is not None
        assert found.robot.numbers == {"sender_hz": 40.0}
        assert found.stream_hz["wrench"] is None
        assert found.stream_hz["robot/state"] == pytest.approx(50.0, rel=0.5)
        assert (code, words["address"], words["process robot"]) == (NOT_WELL, "SKIP", "PASS")
        assert (words["sender"], words["link"]) == ("SKIP", "FAIL")
        assert controller.machine.tcp.sockets == ()

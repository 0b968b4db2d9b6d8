"""Verbs on a bus whose services are simulated by a stand-in."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from cli.context import NO_ANSWER, NOT_WELL, OK, REFUSED, USAGE
from common.bus.cell_bus import open_hub
from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig as CellFile
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.client import LostError
from forcemesh.faults import FAULTS
from forcemesh.messages import (
    ArbiterStatus,
    ArmPurpose,
    GoalReport,
    RobotCommand,
    RobotState,
    Speed,
    WrenchAtTcp,
)
from forcemesh.requests import ArmRequest, BackOffRequest, MoveRequest, Reply
from tests.fakes.verb_calls import run

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("cell_file")]


ARMINGS: tuple[tuple[list[str], ArmPurpose], ...] = ((["arm"], "all"), (["arm", "--jog"], "jog"))
REQUESTS = [
    ["arm"],
    ["hold"],
    ["clear"],
    ["tare"],
    ["move", "to", "0,0,0,0,0,0"],
    ["move", "by", "-5,0,0,0,0,0"],
    ["retract"],
    ["speed", "--accel", "50"],
    ["force", "start"],
    ["force", "stop"],
    ["force", "gains"],
]


class StandIn:
    """Stand-in for arbiter, regulator, wrench and robot, with settable replies."""

    def __init__(self, cell: CellFile) -> None:
        self.requests: list[object] = []
        self.reply = Reply(accepted=True, text="accepted", value=7.0)
        self.goal = GoalReport()
        self.state = "ARMED"
        self.wrench: WrenchAtTcp | None = None
        self._cell = cell
        self._stop, self._ready = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> "StandIn":
        self._thread.start()
        assert self._ready.wait(20.0)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _serve(self) -> None:
        with open_hub(self._cell) as hub:
            inboxes = [hub.playing(r.server).inbox(r) for r in topics.REQUESTS]
            robot = hub.playing("robot").publisher(topics.ROBOT_STATE)
            command = hub.playing("arbiter").publisher(topics.ROBOT_COMMAND)
            status = hub.playing("arbiter").publisher(topics.ARBITER_STATUS)
            wrench = hub.playing("wrench").publisher(topics.WRENCH)
            self._ready.set()
            while not self._stop.wait(0.005):
                for incoming in (i for inbox in inboxes for i in inbox.take_all()):
                    self.requests.append(incoming.request)
                    incoming.reply(self.reply)
                command.put(RobotCommand(speed=Speed(accel_fraction=0.25, mechanical_m_s=0.1)))
                status.put(ArbiterStatus.from_dict({"state": self.state}))
                if self.wrench is not None:
                    wrench.put(self.wrench)
                robot.put(RobotState(position_m=(0.1, 0.2, 0.3), goal=self.goal))


@pytest.fixture
def services(cell_file: Path) -> Iterator[StandIn]:
    """A hub and the stand-in on it."""
    with StandIn(load_cell(cell_file)) as stand_in:
        yield stand_in


def test_every_request_verb_prints_the_answer_or_the_refusal(services: StandIn) -> None:
    """Accepted: the text and 0. Refused: code, text, number and limit on standard error, and 3."""
    services.goal, services.reply = GoalReport(id=7, state="done"), Reply(accepted=True, value=7.0)
    for words in REQUESTS:
        assert (run(*words).exit_code, words) == (OK, words)
    services.reply = Reply(accepted=False, code="busy", text="not now", value=1.5, limit=1.0)
    for words in REQUESTS:
        done = run(*words)
        assert (done.exit_code, words) == (REFUSED, words)
        remedy = FAULTS["busy"].remedy
        assert done.stderr == f"refused (busy): not now [value 1.5, limit 1] -> {remedy}\n"
        assert done.stdout == ""


def test_arming_requests_its_purpose(services: StandIn) -> None:
    """The purpose is all, or jog with the option."""
    for words, purpose in ARMINGS:
        assert run(*words).exit_code == OK
        assert services.requests[-1] == ArmRequest(purpose=purpose)


@pytest.mark.parametrize(
    "words",
    [
        ["move", "by", "-5,0,0,0,0,90", "--speed", "20", "--no-wait"],
        ["move", "by", "--speed", "20", "-5,0,0,0,0,90", "--no-wait"],
        ["move", "by", "--no-wait", "--speed", "20", "--", "-5,0,0,0,0,90"],
    ],
)
def test_a_move_may_begin_with_a_minus_sign(services: StandIn, words: list[str]) -> None:
    """Degrees and mm/s become radians and m/s, for any position of the options."""
    assert run(*words).exit_code == OK
    request = services.requests[-1]
    assert isinstance(request, MoveRequest)
    assert (request.kind, request.speed_m_s) == ("by", 0.02)
    assert request.joint_rad == pytest.approx((-0.0872664626, 0, 0, 0, 0, 1.5707963268))


def test_a_move_to_a_pose_is_sent_in_si(services: StandIn) -> None:
    """Millimetres and O, A, T become metres and a quaternion: A = 180 is half a turn about y."""
    assert run("move", "to", "-100,475,377,0,180,0", "--no-wait").exit_code == OK
    request = services.requests[-1]
    assert isinstance(request, MoveRequest)
    assert request.pose is not None
    assert request.pose.position_m == pytest.approx((-0.1, 0.475, 0.377))
    assert [abs(q) for q in request.pose.orientation_xyzw] == pytest.approx([0, 1, 0, 0], abs=1e-9)


def change_after_request(services: StandIn, change: Callable[[], None]) -> threading.Thread:
    """Apply a change from another thread, shortly after the first request."""

    def run_later() -> None:
        while not services.requests:
            time.sleep(0.01)
        time.sleep(0.3)
        change()

    thread = threading.Thread(target=run_later)
    thread.start()
    return thread


def test_a_move_waits_until_its_own_goal_is_done(services: StandIn) -> None:
    """The report of an older goal is ignored."""
    services.reply = Reply(accepted=True, text="move accepted: goal 8", value=8.0)
    services.goal = GoalReport(id=7, state="done")
    waiting = change_after_request(
        services, lambda: setattr(services, "goal", GoalReport(id=8, state="done"))
    )
    done = run("move", "by", "1,0,0,0,0,0")
    assert not waiting.is_alive()
    assert done.exit_code == OK
    assert "flange at 100.00, 200.00, 300.00 mm" in done.stdout


def test_a_move_that_the_robot_refuses_is_a_refusal(services: StandIn) -> None:
    """Only the robot can detect that a pose is out of reach."""
    services.reply = Reply(accepted=True, value=8.0)
    services.goal = GoalReport(id=8, state="refused", reason="out of reach")
    done = run("move", "by", "1,0,0,0,0,0")
    assert done.exit_code == REFUSED
    assert done.stderr == (
        f"refused (goal_refused): out of reach -> {FAULTS['goal_refused'].remedy}\n"
    )


def test_a_move_that_the_robot_aborts_is_not_done(services: StandIn) -> None:
    """It is no refusal: the move had begun, so the arm's position has changed."""
    services.reply = Reply(accepted=True, value=8.0)
    services.goal = GoalReport(id=8, state="running")
    aborted = GoalReport(id=8, state="refused", reason="permission is stale")
    change_after_request(services, lambda: setattr(services, "goal", aborted))
    done = run("move", "by", "1,0,0,0,0,0")
    assert done.exit_code == NOT_WELL
    assert done.stderr == "the move ended before its goal: permission is stale\n"


def test_a_move_that_is_stopped_before_its_goal_is_not_done(services: StandIn) -> None:
    """A hold by another client ends the wait."""
    services.reply = Reply(accepted=True, value=8.0)
    services.state = "HOLDING"
    done = run("move", "by", "1,0,0,0,0,0")
    assert done.exit_code == NOT_WELL
    assert "the arbiter is HOLDING" in done.stderr


def test_speeds_that_are_left_out_keep_their_value(services: StandIn) -> None:
    """The request carries all speeds; the unnamed ones are those that the arbiter publishes."""
    assert run("speed", "--decel", "50").exit_code == OK
    expected = Speed(accel_fraction=0.25, decel_fraction=0.5, mechanical_m_s=0.1)
    assert services.requests[-1] == expected


@pytest.mark.usefixtures("services")
def test_watch_prints_the_requested_number_of_messages() -> None:
    """Each message is one line of JSON with the fields of header and message."""
    rows = [
        json.loads(line)
        for line in run("watch", "robot/state", "--count", "3", "--json").stdout.splitlines()
    ]
    assert len(rows) == 3
    assert [row["position_m"] for row in rows] == [[0.1, 0.2, 0.3]] * 3
    assert rows[0]["seq"] < rows[1]["seq"] < rows[2]["seq"]
    assert {"epoch", "boot", "stamp_ns", "valid", "joint_rad"} <= set(rows[0])
    assert "position_m" in run("watch", "robot/state", "--count", "2").stdout


@pytest.mark.usefixtures("services")
def test_watch_writes_a_new_file_and_never_overwrites_one(tmp_path: Path) -> None:
    """It writes one topic to one new file; other usage is refused with the reason."""
    path = str(tmp_path / "robot.csv")
    done = run("watch", "robot/state", "--seconds", "0.5", "--csv", path)
    assert done.exit_code == OK
    rows = Path(path).read_text().splitlines()
    assert f"{len(rows) - 1} messages of robot/state, 0 lost" in done.stdout
    assert len(rows) > 10
    again = run("watch", "robot/state", "--seconds", "0.5", "--csv", path)
    assert (again.exit_code, "exists" in again.stderr) == (USAGE, True)
    assert Path(path).read_text().splitlines() == rows
    nowhere = run("watch", "robot/state", "--csv", str(tmp_path / "no" / "robot.csv"))
    assert (nowhere.exit_code, "cannot be written" in nowhere.stderr) == (USAGE, True)
    for words in (["watch", "--csv", "x"], ["watch", "wrench", "--json", "--csv", "x"]):
        wrong = run(*words)
        assert (wrong.exit_code, "takes one topic" in wrong.stderr) == (USAGE, True)
    all_topics = run("watch", "--seconds", "0.1")
    assert (all_topics.exit_code, "regulator/target" in all_topics.stdout) == (OK, True)


@pytest.mark.usefixtures("services")
def test_watch_ends_on_a_silent_topic(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A script does not wait forever."""
    monkeypatch.setattr("cli.verbs_watch.SILENCE_S", 0.2)
    done = run("watch", "wrench", "--count", "1", "--json")
    assert done.exit_code == NO_ANSWER
    assert "nothing on wrench" in done.stderr


@pytest.mark.parametrize(
    ("words", "position_m", "joint_rad"),
    [
        (["jog", "z", "-10"], (0.1, 0.2, 0.29), None),
        (["jog", "x", "5", "--speed", "20"], (0.105, 0.2, 0.3), None),
        (["jog", "j6", "-90"], None, (0.0, 0.0, 0.0, 0.0, 0.0, -1.5707963268)),
    ],
)
def test_a_jog_is_a_move_relative_to_the_present_pose(
    services: StandIn,
    words: list[str],
    position_m: tuple[float, ...] | None,
    joint_rad: tuple[float, ...] | None,
) -> None:
    """Millimetres along an axis, or degrees of a joint; negative numbers are accepted."""
    services.goal = GoalReport(id=7, state="done")
    assert run(*words).exit_code == OK
    request = services.requests[-1]
    assert isinstance(request, MoveRequest)
    if position_m is not None and request.pose is not None:
        assert request.pose.position_m == pytest.approx(position_m)
        assert request.pose.orientation_xyzw == pytest.approx((0, 0, 0, 1))
    assert request.joint_rad == (None if joint_rad is None else pytest.approx(joint_rad))


def test_a_seventh_joint_is_jogged_only_where_the_arm_has_one(services: StandIn) -> None:
    """A move names its joints itself: the arbiter compares their number with the arm's."""
    done = run("jog", "j7", "5")
    assert (done.exit_code, services.requests) == (USAGE, [])
    assert "j7: the arm has 6 joints" in done.stderr
    services.goal = GoalReport(id=7, state="done")
    assert run("move", "by", "0,0,0,0,0,0,90").exit_code == OK
    request = services.requests[-1]
    assert isinstance(request, MoveRequest)
    assert request.joint_rad == pytest.approx((0.0,) * 6 + (1.5707963268,))


def test_a_jog_far_out_of_range_is_refused_with_a_rounded_number(services: StandIn) -> None:
    """The error gives one rounded number and the limit; nothing is requested."""
    done = run("jog", "z", "1e9")
    assert done.exit_code == USAGE
    assert "pose.position_m.2: must be at most 100 m, found 1e+06 m" in done.stderr
    assert services.requests == []


@pytest.mark.parametrize("words", [["jog", "z", "-10"], ["move", "by", "1,0,0,0,0,0"]])
def test_a_move_of_a_loaded_tool_needs_confirmation(services: StandIn, words: list[str]) -> None:
    """The question gives force and permitted rise; without an answer nothing is requested."""
    services.goal = GoalReport(id=7, state="done")
    services.wrench = WrenchAtTcp(calibrated=True, force_N=(0.0, 0.0, 12.3))
    done = run(*words)
    assert done.exit_code == REFUSED
    assert "loaded with 12.3 N; a rise of 20 N stops the move" in done.stderr
    assert "--yes" in done.stderr
    assert services.requests == []
    assert run(*words, "--yes").exit_code == OK
    services.wrench = WrenchAtTcp(calibrated=False, force_N=(0.0, 0.0, 12.3))
    assert run(*words).exit_code == OK


def test_backing_off_needs_confirmation_and_prints_the_reason_of_a_refusal(
    services: StandIn,
) -> None:
    """Without an answer nothing is requested; a refusal for lack of a force names the option."""
    assert run("back-off").exit_code == REFUSED
    assert services.requests == []
    services.reply = Reply(accepted=False, code="no_direction", text="no force can be followed")
    done = run("back-off", "--yes")
    assert (done.exit_code, services.requests) == (REFUSED, [BackOffRequest()])
    assert "--without-force" in done.stderr
    assert run("back-off", "--yes", "--without-force").exit_code == REFUSED
    assert services.requests[-1] == BackOffRequest(without_force=True)


def test_speeds_are_printed_without_options_too(services: StandIn) -> None:
    """Without a change nothing is requested."""
    found = json.loads(run("speed", "--json").stdout)
    assert (found["accel_fraction"], found["mechanical_m_s"]) == (0.25, 0.1)
    assert services.requests == []
    assert "later moves run at 100.0 mm/s" in run("speed").stdout


@pytest.mark.usefixtures("services")
def test_watch_without_a_topic_shows_the_rate_of_every_topic() -> None:
    """It shows rate and age of each topic, and the silent ones."""
    found = json.loads(run("watch", "--count", "1", "--json").stdout)
    rows = {row["topic"]: row for row in found["topics"]}
    assert list(rows) == [topic.key for topic in topics.TOPICS]
    assert rows["robot/state"]["fault"] == ""
    assert rows["robot/state"]["rate_hz"] > 10.0
    assert rows["robot/state"]["age_s"] < 1.0
    assert rows["wrench"]["fault"] == "wrench missing"
    assert (rows["wrench"]["rate_hz"], rows["wrench"]["age_s"]) == (None, None)


@pytest.mark.usefixtures("services")
def test_watch_shows_no_fault_of_a_topic_that_is_published_only_when_something_happens() -> None:
    """Without a request the silence of its topic is not a fault, and it has no rate."""
    found = json.loads(run("watch", "--count", "1", "--json").stdout)
    row = {row["topic"]: row for row in found["topics"]}["arbiter/requests"]
    assert (row["fault"], row["expected_hz"], row["stale_after_s"]) == ("", None, None)
    lines = run("watch", "--count", "1").stdout.splitlines()
    assert not any("missing" in line for line in lines if "arbiter/requests" in line)


def test_a_client_serves_many_threads_at_once(services: StandIn, cell_file: Path) -> None:
    """As with buttons and plots of a panel: every request has its reply, every reading is valid."""
    with ConfiguredCell(cell_file) as cell, ThreadPoolExecutor(8) as pool:
        replies = [pool.submit(cell.hold, f"thread {i}") for i in range(16)]
        states = [pool.submit(cell.state) for _ in range(64)]
        assert all(each.result().accepted for each in replies)
        assert {each.result().position_m for each in states} == {(0.1, 0.2, 0.3)}
    assert len(services.requests) == 16


def test_a_client_names_the_silent_roles_of_its_cell(services: StandIn, cell_file: Path) -> None:
    """The hub responds, no role publishes its health: all roles are named."""
    del services
    with ConfiguredCell(cell_file) as cell, pytest.raises(LostError) as caught:
        cell.wrench(within_s=0.1)
    assert caught.value.roles == topics.ROLES
    assert "wrench missing" in str(caught.value)

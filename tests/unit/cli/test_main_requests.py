"""Verbs on a bus whose services are simulated by a stand-in."""

import csv
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli.context import NOT_WELL, OK, REFUSED, USAGE
from common.bus.cell_bus import open_hub
from common.config.cell import CellConfig as CellFile
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.faults import FAULTS
from forcemesh.messages import (
    ArbiterStatus,
    GoalReport,
    RobotCommand,
    RobotState,
    Speed,
    WrenchAtTcp,
)
from forcemesh.requests import ArmRequest, BackOffRequest, MoveRequest, Reply
from tests.fakes.verb_calls import run

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("cell_file")]

REQUESTS = [
    ["arm"],
    ["arm", "--jog"],
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
        self.goal = GoalReport(id=7, state="done")
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
                status.put(ArbiterStatus(state="ARMED"))
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
    for words in REQUESTS:
        assert (run(*words).exit_code, words) == (OK, words)
    assert services.requests[:2] == [ArmRequest(purpose="all"), ArmRequest(purpose="jog")]
    services.reply = Reply(accepted=False, code="busy", text="not now", value=1.5, limit=1.0)
    for words in REQUESTS:
        done = run(*words)
        assert (done.exit_code, words) == (REFUSED, words)
        remedy = FAULTS["busy"].remedy
        assert done.stderr == f"refused (busy): not now [value 1.5, limit 1] -> {remedy}\n"
        assert done.stdout == ""


def test_a_move_is_sent_in_si(services: StandIn) -> None:
    """Degrees, mm and mm/s; a move may begin with a minus sign; a jog is relative to the pose."""

    def sent(*words: str) -> MoveRequest:
        assert run(*words).exit_code == OK
        request = services.requests[-1]
        assert isinstance(request, MoveRequest)
        return request

    for words in (
        ("-5,0,0,0,0,90", "--speed", "20", "--no-wait"),
        ("--no-wait", "--speed", "20", "--", "-5,0,0,0,0,90"),
    ):
        move = sent("move", "by", *words)
        assert (move.kind, move.speed_m_s) == ("by", 0.02)
        assert move.joint_rad == pytest.approx((-0.0872664626, 0, 0, 0, 0, 1.5707963268))
    pose = sent("move", "to", "-100,475,377,0,180,0", "--no-wait").pose
    assert pose is not None
    assert pose.position_m == pytest.approx((-0.1, 0.475, 0.377))
    assert [abs(q) for q in pose.orientation_xyzw] == pytest.approx([0, 1, 0, 0], abs=1e-9)
    pose = sent("jog", "z", "-10", "--speed", "20").pose
    assert pose is not None
    assert pose.position_m == pytest.approx((0.1, 0.2, 0.29))
    assert pose.orientation_xyzw == pytest.approx((0, 0, 0, 1))
    assert sent("jog", "j6", "-90").joint_rad == pytest.approx((0.0,) * 5 + (-1.5707963268,))
    # A move names its joints itself: the arbiter compares their number with the arm's.
    assert len(sent("move", "by", "0,0,0,0,0,0,90").joint_rad or ()) == 7
    done = run("jog", "j7", "5")
    assert (done.exit_code, "j7: the arm has 6 joints" in done.stderr) == (USAGE, True)


def test_a_goal_that_the_robot_refuses_or_aborts_is_not_reached(services: StandIn) -> None:
    """Refused at once, it is a refusal; aborted, the arm's position has changed: it is none."""
    services.reply = Reply(accepted=True, value=8.0)
    refused = GoalReport(id=8, state="refused", reason="out of reach")
    services.goal = refused
    done = run("move", "by", "1,0,0,0,0,0")
    assert done.exit_code == REFUSED
    assert done.stderr.startswith("refused (goal_refused): out of reach -> ")
    services.goal = GoalReport(id=8, state="running")

    def abort() -> None:
        while len(services.requests) == 1:
            time.sleep(0.01)
        time.sleep(0.3)
        services.goal = refused

    threading.Thread(target=abort).start()
    done = run("move", "by", "1,0,0,0,0,0")
    assert (done.exit_code, done.stderr) == (
        NOT_WELL,
        "the move ended before its goal: out of reach\n",
    )


def test_speeds_that_are_left_out_keep_their_value(services: StandIn) -> None:
    """The request carries all speeds; the unnamed ones are those that the arbiter publishes."""
    found = json.loads(run("speed", "--json").stdout)
    assert (found["accel_fraction"], found["mechanical_m_s"]) == (0.25, 0.1)
    assert services.requests == []
    assert run("speed", "--decel", "50").exit_code == OK
    expected = Speed(accel_fraction=0.25, decel_fraction=0.5, mechanical_m_s=0.1)
    assert services.requests[-1] == expected


@pytest.mark.usefixtures("services")
def test_watch_prints_messages_and_writes_a_new_file(tmp_path: Path) -> None:
    """Each message is one line of JSON, or a row of one new file of one topic."""
    done = run("watch", "robot/state", "--count", "3", "--json")
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["position_m"] for row in rows] == [[0.1, 0.2, 0.3]] * 3
    assert rows[0]["seq"] < rows[1]["seq"] < rows[2]["seq"]
    path = tmp_path / "robot.csv"
    done = run("watch", "robot/state", "--seconds", "0.5", "--csv", path)
    assert done.exit_code == OK
    lines = path.read_text().splitlines()
    assert f"{len(lines) - 1} messages of robot/state, 0 lost" in done.stdout
    assert len(lines) > 10
    rows = list(csv.DictReader(lines))
    assert [float(rows[3][f"position_m.{axis}"]) for axis in "xyz"] == [0.1, 0.2, 0.3]
    assert 0.0 == float(rows[0]["time_s"]) < float(rows[-1]["time_s"]) < 0.6
    for words, sentence in (
        (("watch", "robot/state", "--csv", path), "exists"),
        (("watch", "robot/state", "--csv", tmp_path / "no" / "robot.csv"), "cannot be written"),
        (("watch", "--csv", "x"), "takes one topic"),
        (("watch", "wrench", "--json", "--csv", "x"), "takes one topic"),
    ):
        wrong = run(*words)
        assert (wrong.exit_code, sentence in wrong.stderr) == (USAGE, True), words
    assert path.read_text().splitlines() == lines


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
    row = rows["arbiter/requests"]  # published only when something happens: silence is no fault
    assert (row["fault"], row["expected_hz"], row["stale_after_s"]) == ("", None, None)
    shown = run("watch", "--seconds", "0.1")
    assert (shown.exit_code, "regulator/target" in shown.stdout) == (OK, True)


@pytest.mark.parametrize("words", [["jog", "z", "-10"], ["move", "by", "1,0,0,0,0,0"]])
def test_a_move_of_a_loaded_tool_needs_confirmation(services: StandIn, words: list[str]) -> None:
    """The question gives force and permitted rise; without an answer nothing is requested."""
    services.wrench = WrenchAtTcp(calibrated=True, axes_checked=True, force_N=(0.0, 0.0, 12.3))
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

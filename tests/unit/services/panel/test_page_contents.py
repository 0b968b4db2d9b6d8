"""The panel's view of received messages: plots, bar, log of faults, progress of the wizard."""

from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.convert import vec3
from common.motion.frames import rotation_from_vector
from forcemesh.bus import Reading
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import (
    Accepted,
    ArbiterStatus,
    Goal,
    Health,
    PoseRecord,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    WrenchAtTcp,
)
from forcemesh.requests import ForceStartRequest
from services.panel.faultlog import FAULTS_KEPT, FaultLog
from services.panel.plots import BRIDGED_S, HISTORY_POINTS, OUTSIDE, PlotHistory, Span, broken
from services.panel.readout import NAMES, Readout, distance_mm
from services.panel.status_bar import UNANSWERED, held_as, stop_text, strip
from services.panel.tabs.calibrate import notes_of
from services.panel.tabs.faults import SHOWN, log_text, now_text
from services.panel.tabs.force import start_question
from services.panel.viewer import RequestOutcome
from services.panel.watch import Snapshot
from services.panel.wizard import Progress, WizardProcess

CELL = load_cell(Path(__file__).parents[4] / "cells" / "demo.yaml")
numbers = st.floats(-1e4, 1e4)


def received(message, fault=""):
    """Return a reading of a fresh message, or of one with a fault."""
    return Reading(message, None, 0.004, fault, silent="stale" in fault)


def pressing(force_N, error_N, *, down=np.pi):
    """Return the snapshot of a pressing tool that is turned about x."""
    R = rotation_from_vector(np.array([down, 0.0, 0.0]))
    q = (float(np.sin(down / 2)), 0.0, 0.0, float(np.cos(down / 2)))
    force, error = vec3(-force_N * R[:, 2]), vec3(-error_N * R[:, 2])
    return Snapshot(
        hub_fault="",
        robot=received(RobotState(orientation_xyzw=q)),
        wrench=received(WrenchAtTcp(force_N=force)),
        target=received(RegulatorTarget(mode="position", error_force_N=error)),
    )


# --- plots ----------------------------------------------------------------------------------------


@given(st.lists(st.dictionaries(st.sampled_from(["a", "b"]), numbers), max_size=30))
def test_a_history_keeps_the_newest_samples_in_order(samples):
    """A plot gets the newest points in order, with gaps for unknown numbers, two at least."""
    history = PlotHistory(("a", "b"), points=8)
    for count, sample in enumerate(samples):
        history.add(float(count), sample)
    times, a, b = history.series(("a", "b"), float(len(samples)))
    assert len(times) == len(a) == len(b) >= 2
    kept = samples[-8:]
    assert len(history) == len(kept)
    if len(kept) >= 2:
        assert list(times) == [count - len(kept) for count in range(len(kept))]
        for sample, value in zip(kept, a, strict=True):
            assert value == sample["a"] if "a" in sample else np.isnan(value)


@given(st.lists(st.lists(numbers, min_size=1, max_size=5), min_size=1, max_size=20))
def test_an_axis_always_has_a_margin_and_changes_rarely(windows):
    """No value is outside; the ends are 1, 2 or 5 times a power of ten, around zero."""
    span = Span(1.0)
    for window in windows:
        span.take((np.array([*window, np.nan]),))
        assert span.low <= min(window)
        assert max(window) <= span.high
        assert span.low < 0.0 < span.high
        for end in (-span.low, span.high):
            assert round(end / 10 ** np.floor(np.log10(end) + 1e-9), 6) in (1, 2, 5, 10)
    assert not span.take((np.array(windows[-1]),))


def test_an_axis_without_a_sign_begins_at_zero_until_a_value_is_below():
    """A time is never negative; a negative one would still be visible."""
    span = Span(5.0, signed=False)
    span.take((np.array([3.0, 70.0]),))
    assert (span.low, span.high) == (0.0, 100.0)
    span.take((np.array([-3.0]),))
    assert span.low < -3.0


@given(
    st.lists(st.tuples(st.floats(0.01, 1.0), st.one_of(st.just(np.nan), st.floats(-50.0, 50.0)))),
)
def test_a_line_leaves_the_plot_in_its_longer_gaps_only(samples):
    """Known samples stay; between two distant ones the line is outside the plot."""
    times_s = np.cumsum([step for step, _ in samples]) if samples else np.zeros(0)
    line = np.array([value for _, value in samples])
    shown = broken(times_s, line)
    known = np.flatnonzero(np.isfinite(line))
    assert (shown[known] == line[known]).all()
    for place in np.flatnonzero(~np.isfinite(line)):
        before, after = known[known < place], known[known > place]
        inside = len(before) > 0 and len(after) > 0
        is_long = inside and times_s[after[0]] - times_s[before[-1]] > BRIDGED_S
        assert (shown[place] == OUTSIDE) == is_long


def test_gaps_alone_do_not_change_an_axis():
    """A plot without values keeps its axis."""
    assert not Span(5.0).take((np.full(4, np.nan),))
    assert HISTORY_POINTS <= 800


@given(st.floats(0.0, 40.0), st.floats(0.0, 40.0))
def test_the_set_point_follows_from_the_regulators_error(force_N, setpoint_N):
    """Force and error give it in any attitude; within the deadband it is close to the force."""
    off_N = force_N - setpoint_N
    width_N = CELL.force.deadband_N
    shown_N = 0.0 if abs(off_N) <= width_N else off_N - np.sign(off_N) * width_N
    for down in (np.pi, 0.3):
        found = Readout(CELL).numbers(pressing(force_N, shown_N, down=down))
        assert found["press"] == pytest.approx(force_N, abs=1e-6)
        assert found["set point"] == pytest.approx(setpoint_N, abs=width_N + 1e-6)
        if shown_N:
            assert found["set point"] == pytest.approx(setpoint_N, abs=1e-6)
        assert set(found) <= set(NAMES)


def test_the_set_point_is_constant_once_the_force_is_reached():
    """Noise inside the deadband does not move the line."""
    readout = Readout(CELL)
    readout.numbers(pressing(10.0, -5.0 + CELL.force.deadband_N))
    for force_N in (14.9, 15.2, 14.8):
        assert readout.numbers(pressing(force_N, 0.0))["set point"] == pytest.approx(15.0)


def test_a_latency_is_shown_once():
    """It belongs to a command that the robot took; without a new one there is none."""
    readout = Readout(CELL)
    taken = Accepted(epoch=1, seq=7, at_ns=5_000_000, sensor_stamp_ns=1_000_000)
    now = Snapshot(robot=received(RobotState(accepted=taken)))
    assert readout.numbers(now)["chain"] == pytest.approx(4.0)
    assert "chain" not in readout.numbers(now)
    later = taken.replaced(seq=8)
    assert "chain" in readout.numbers(Snapshot(robot=received(RobotState(accepted=later))))


def test_unknown_values_are_left_out():
    """Without messages there are no numbers; without force feedback no set point."""
    assert Readout(CELL).numbers(Snapshot()) == {}
    idle = replace(pressing(3.0, 0.0), target=received(RegulatorTarget(valid=False), "invalid"))
    assert "set point" not in Readout(CELL).numbers(idle)


def test_the_distance_is_to_the_goal_or_to_the_streamed_pose():
    """A hold has none, a goal in joints has none."""
    pose = PoseRecord(position_m=(0.001, 0.0, 0.0), orientation_xyzw=(0.0, 0.0, 0.0, 1.0))
    robot = RobotState()
    goal = Goal(id=1, kind="pose", pose=pose)
    for command in (
        RobotCommand(kind="setpoint", pose=pose),
        RobotCommand(kind="goal", goal=goal),
    ):
        assert distance_mm(command, robot)["distance"] == pytest.approx(1.0)
    assert distance_mm(RobotCommand(kind="hold", pose=pose), robot) == {}
    assert distance_mm(RobotCommand(kind="goal", goal=Goal(id=1, kind="by")), robot) == {}


# --- the bar --------------------------------------------------------------------------------------


def all_received(status, **more):
    """Return a snapshot in which every service has been received."""
    health = {role: received(Health(rate_hz=250.0)) for role in ("hub", "robot", "wrench")}
    return Snapshot(hub_fault="", arbiter=received(status), health=health | more)


def test_the_bar_shows_the_present_problem():
    """It has state, commander, cause and remedy, also without a hub or an arbiter."""
    trip = tripped("force", "61 N")
    shown_bar = strip(
        CELL, all_received(ArbiterStatus(state="HOLDING", trips=(trip,), clears="arm")), "operate"
    )
    assert (shown_bar["state"], shown_bar["why"], shown_bar["remedy"]) == ("HOLDING", "61 N", "arm")
    assert shown_bar["mode"] == "SIMULATION"
    moving = ArbiterStatus(state="ACTIVE", commander="regulator", armed_for="jog")
    assert strip(CELL, all_received(moving), "operate")["who"] == "commander: regulator"
    assert strip(CELL, all_received(moving), "operate")["state"] == "ACTIVE for jog"
    assert strip(CELL, Snapshot(), "operate")["state"] == "cell not reached"
    assert strip(CELL, Snapshot(hub_fault=""), "operate")["state"] == "no arbiter status"


def test_the_bar_shows_each_service_and_its_fault():
    """It has rate and age of each one; a silent or faulty one is marked."""
    wrong = {
        "sensor": received(Health(rate_hz=500.0, fault="the cable is out")),
        "arbiter": received(None, "arbiter/health stale"),
    }
    rows = {
        row["name"]: row
        for row in strip(CELL, all_received(ArbiterStatus(), **wrong), "view")["services"]
    }
    assert rows["hub"] == {"name": "hub", "text": "250 Hz · 4 ms", "fault": ""}
    assert rows["sensor"]["fault"] == "the cable is out"
    assert rows["arbiter"]["fault"] == "arbiter/health stale"
    assert rows["regulator"]["fault"]
    assert "recorder" not in rows


def test_the_bar_shows_a_recorder_once_it_was_received():
    """A cell without a recorder lacks nothing; one that has stopped is missing."""
    late = received(Health(rate_hz=4.0), "recorder/health stale")
    for reading, fault in ((received(Health(rate_hz=4.0)), ""), (late, "recorder/health stale")):
        rows = strip(CELL, all_received(ArbiterStatus(), recorder=reading), "view")["services"]
        assert (rows[-1]["name"], rows[-1]["fault"]) == ("recorder", fault)


def test_the_faults_do_not_name_a_recorder_that_never_ran():
    """A cell without a recorder lacks nothing; one that fell silent is reported."""
    healthy = {role: received(Health(rate_hz=250.0)) for role in ("sensor", "regulator", "arbiter")}
    never: dict[str, Any] = {
        "recorder": Reading(None, None, 9.0, "recorder/health missing", silent=True)
    }
    silent = {"recorder": received(Health(rate_hz=10.0), "recorder/health stale")}
    idle = ArbiterStatus(state="IDLE")
    assert "recorder" not in now_text(all_received(idle, **healthy, **never))
    shown = now_text(all_received(idle, **healthy, **silent))
    assert "⚠ recorder: recorder/health stale" in shown


@pytest.mark.parametrize("monitor", [False, True])
def test_a_view_only_page_stops_the_arm_where_the_cell_lets_a_monitor(monitor):
    """An operator always may; a view-only page may if a certificate that only reads may."""
    cell = CELL.model_copy(
        update={"bus": CELL.bus.model_copy(update={"monitor_may_hold": monitor})}
    )
    assert strip(cell, Snapshot(), "operate")["may_stop"] is True
    assert strip(cell, Snapshot(), "view")["may_stop"] is monitor


def test_a_cell_with_an_arm_is_shown_as_real():
    """The panel always shows whether the arm is real."""
    real = load_cell(Path(__file__).parents[4] / "cells" / "rs007l-real.yaml")
    assert strip(real, Snapshot(), "view")["mode"] == "REAL"


@pytest.mark.parametrize(
    ("word", "state", "prefix"),
    [
        ("done", "ACTIVE", "text"),
        ("refused", "HOLDING", "refused: text"),
        ("no answer", "HOLDING", "the arm is held (state HOLDING); the reply was lost"),
        ("no answer", "FAULT", "the arm is held (state FAULT); the reply was lost"),
        ("no answer", "STOPPING", f"{UNANSWERED} from the cell (text). Use the emergency stop"),
        ("no answer", "ACTIVE", f"{UNANSWERED} from the cell (text). Use the emergency stop"),
        ("no answer", None, f"{UNANSWERED} from the cell (text). Use the emergency stop"),
    ],
)
def test_a_stop_is_unanswered_only_where_the_state_does_not_confirm_it(word, state, prefix):
    """The state is checked before the message; an old or unknown state confirms nothing."""
    status = None if state is None else ArbiterStatus(state=state)
    shown = Snapshot(hub_fault="", arbiter=received(status, "" if status else "missing"))
    assert stop_text(RequestOutcome(word, "text"), shown).startswith(prefix)
    assert bool(held_as(shown)) is (state in ("HOLDING", "FAULT"))
    stale = Snapshot(hub_fault="", arbiter=received(status, "arbiter/status stale"))
    assert held_as(stale) == ""


# --- log of faults --------------------------------------------------------------------------------


@given(st.lists(st.sets(st.sampled_from(["force", "hold", "stale"])), max_size=30))
def test_the_log_has_each_reason_once_for_each_occurrence(histories):
    """A lasting reason is one line; one that ends and returns is two; newest first."""
    log, expected = FaultLog(lambda: "now"), 0
    before: set[str] = set()
    for reasons in histories:
        trips = tuple(tripped(code, code) for code in sorted(reasons))
        log.saw(ArbiterStatus(state="HOLDING", trips=trips))
        log.saw(None)  # a missing status ends no reason
        expected += len(reasons - before)
        before = reasons
    assert len(log.newest()) == min(expected, FAULTS_KEPT)
    shown = log_text(log.newest())
    assert all(escape(FAULTS[one.trip.code].remedy) in shown for one in log.newest()[:SHOWN])


# --- the wizard -----------------------------------------------------------------------------------


def test_messages_of_the_wizard_become_progress():
    """Plan, question, running, residuals, end; an error and a crash are failures."""
    progress = Progress()
    for shown_bar, phase in (
        ({"plan": "ten poses"}, "asking"),
        ({"progress": 0.4, "text": "pose 3"}, "running"),
        ({"note": "a line"}, "running"),
        ({"left": {"fit_N": [0.1]}}, "running"),
        ({"end": 0}, "done"),
    ):
        progress.update(shown_bar)
        assert progress.phase == phase
    assert (progress.plan, progress.text, list(progress.notes)) == (
        "ten poses",
        "pose 3",
        ["a line"],
    )
    progress.update({"error": "no hub"})
    progress.update({"end": 2})
    assert progress.phase == "failed"
    assert progress.notes[-1] == "⚠ no hub"


def test_the_result_of_a_calibration_is_a_table():
    """It has the verdict, parameters with deviations, then the other messages."""
    progress = Progress()
    progress.update({"note": "⚠ a loose cable"})
    note = "<p><code>⚠ a loose cable</code></p>"
    assert notes_of(progress) == note
    progress.update({"left": {"verdict": "PASS", "found": [["mass (kg)", "1.2", "0.1"]]}})
    shown = notes_of(progress)
    assert shown.startswith("<p><b>PASS</b></p><table>")
    row = "<tr><td>mass (kg)</td><td>1.2</td><td>0.1</td></tr></table>"
    assert shown.endswith(row + note)


@pytest.mark.processes
def test_the_wizard_of_a_cell_that_is_down_reports_it(tmp_path):
    """The child process ends with one clear line, and another one may be started."""
    path = tmp_path / "cell.yaml"
    text = (Path(__file__).parents[4] / "cells" / "demo.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("7447", "7399"), encoding="utf-8")
    wizard = WizardProcess(path)
    assert wizard.plan(poses=6, verify_poses=1, speed_mm_s=100.0) == ""
    assert (
        wizard.plan(poses=6, verify_poses=1, speed_mm_s=100.0) == "a calibration is already running"
    )
    wizard.wait(60.0)
    assert wizard.progress.phase == "failed"
    assert "no hub" in " ".join(wizard.progress.notes)
    wizard.close()


def test_the_questions_before_guiding_and_before_pressing_differ():
    """A user agrees to the motion that follows."""
    guide = start_question(ForceStartRequest(law="admittance", mode="position"), 0.05)
    assert "Hand guiding" in guide
    assert "presses" not in guide
    press = start_question(ForceStartRequest(mode="position", setpoint_N=15.0), 0.05)
    assert "<b>15 N</b>" in press
    assert "50 mm" in press

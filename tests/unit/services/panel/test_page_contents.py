"""The panel's view of received messages: plots, log of faults, progress of the wizard."""

from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.convert import vec3
from common.motion.frames import rotation_from_vector
from forcemesh.bus import Reading
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import (
    Accepted,
    ArbiterStatus,
    Goal,
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
from services.panel.tabs.calibrate import notes_of
from services.panel.tabs.faults import SHOWN, log_text
from services.panel.tabs.force import start_question
from services.panel.watch import Snapshot
from services.panel.wizard import Progress, WizardProcess
from tests.fakes.bench import CELL, DEMO

numbers = st.floats(-1e4, 1e4)


def received(message, fault=""):
    """Return a reading of a fresh message, or of one with a fault."""
    return Reading(message, None, 0.004, fault, silent="stale" in fault)


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


@given(st.lists(st.lists(numbers, min_size=1, max_size=5), min_size=1, max_size=20), st.booleans())
def test_an_axis_always_has_a_margin_and_changes_rarely(windows, signed):
    """No value is outside; the ends are 1, 2 or 5 times a power of ten, around zero.

    An axis without a sign begins at zero until a value is below; gaps change none.
    """
    span, lowest = Span(1.0, signed=signed), 0.0
    for window in windows:
        span.take((np.array([*window, np.nan]),))
        lowest = min(lowest, *window)
        assert span.low <= min(window)
        assert max(window) <= span.high
        assert span.low <= 0.0 < span.high
        assert span.low < 0.0 or not signed
        assert span.low == 0.0 or signed or lowest < 0.0
        for end in (-span.low, span.high):
            assert end == 0.0 or round(end / 10 ** np.floor(np.log10(end) + 1e-9), 6) in (
                1,
                2,
                5,
                10,
            )
    assert not span.take((np.array(windows[-1]),))
    assert not Span(5.0).take((np.full(4, np.nan),))
    assert HISTORY_POINTS <= 800


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


# --- numbers --------------------------------------------------------------------------------------


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


@given(st.floats(0.0, 40.0), st.floats(0.0, 40.0), st.sampled_from([np.pi, 0.3]))
def test_the_set_point_follows_from_the_regulators_error(force_N, setpoint_N, down):
    """Force and error give it in any attitude; inside the deadband the last one is kept."""
    off_N, width_N = force_N - setpoint_N, CELL.force.deadband_N
    shown_N = 0.0 if abs(off_N) <= width_N else off_N - np.sign(off_N) * width_N
    readout = Readout(CELL)
    found = readout.numbers(pressing(force_N, shown_N, down=down))
    assert found["press"] == pytest.approx(force_N, abs=1e-6)
    exact_N = 1e-6 if shown_N else width_N + 1e-6
    assert found["set point"] == pytest.approx(setpoint_N, abs=exact_N)
    assert set(found) <= set(NAMES)
    for noise_N in (-0.9 * width_N, 0.9 * width_N):
        again = readout.numbers(pressing(found["set point"] + noise_N, 0.0, down=down))
        assert again["set point"] == pytest.approx(found["set point"])


def test_unknown_values_are_left_out():
    """Without messages there are no numbers; a set point while pressing; each latency once."""
    assert Readout(CELL).numbers(Snapshot()) == {}
    idle = replace(pressing(3.0, 0.0), target=received(RegulatorTarget(valid=False), "invalid"))
    assert "set point" not in Readout(CELL).numbers(idle)
    readout = Readout(CELL)
    taken = Accepted(epoch=1, seq=7, at_ns=5_000_000, sensor_stamp_ns=1_000_000)
    now = Snapshot(robot=received(RobotState(accepted=taken)))
    assert readout.numbers(now)["chain"] == pytest.approx(4.0)
    assert "chain" not in readout.numbers(now)
    later = taken.replaced(seq=8)
    assert "chain" in readout.numbers(Snapshot(robot=received(RobotState(accepted=later))))


def test_the_distance_is_to_the_goal_or_to_the_streamed_pose():
    """A hold has none, a goal in joints has none."""
    pose = PoseRecord(position_m=(0.001, 0.0, 0.0), orientation_xyzw=(0.0, 0.0, 0.0, 1.0))
    robot = RobotState()
    goal = Goal(id=1, kind="pose", pose=pose)
    for command in (RobotCommand(kind="setpoint", pose=pose), RobotCommand(kind="goal", goal=goal)):
        assert distance_mm(command, robot)["distance"] == pytest.approx(1.0)
    assert distance_mm(RobotCommand(kind="hold", pose=pose), robot) == {}
    assert distance_mm(RobotCommand(kind="goal", goal=Goal(id=1, kind="by")), robot) == {}


# --- log of faults, questions ---------------------------------------------------------------------


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


def test_the_questions_before_guiding_and_before_pressing_differ():
    """A user agrees to the motion that follows."""
    guide = start_question(ForceStartRequest(law="admittance", mode="position"), 0.05)
    assert "Hand guiding" in guide
    assert "presses" not in guide
    press = start_question(ForceStartRequest(mode="position", setpoint_N=15.0), 0.05)
    assert "<b>15 N</b>" in press
    assert "50 mm" in press


# --- the wizard -----------------------------------------------------------------------------------


def test_messages_of_the_wizard_become_progress_and_a_table():
    """Plan, question, running, result, end; an error and a crash are failures."""
    progress = Progress()
    left = {"verdict": "PASS", "found": [["mass (kg)", "1.2", "0.1"]]}
    for line, phase in (
        ({"plan": "ten poses"}, "asking"),
        ({"progress": 0.4, "text": "pose 3"}, "running"),
        ({"note": "⚠ a loose cable"}, "running"),
        ({"left": left}, "running"),
        ({"end": 0}, "done"),
    ):
        progress.update(line)
        assert progress.phase == phase
    assert (progress.plan, progress.text) == ("ten poses", "pose 3")
    shown = notes_of(progress)
    assert shown.startswith("<p><b>PASS</b></p><table>")
    row = "<tr><td>mass (kg)</td><td>1.2</td><td>0.1</td></tr></table>"
    assert shown.endswith(f"{row}<p><code>⚠ a loose cable</code></p>")
    progress.update({"error": "no hub"})
    progress.update({"end": 2})
    assert progress.phase == "failed"
    assert progress.notes[-1] == "⚠ no hub"


@pytest.mark.processes
def test_the_wizard_of_a_cell_that_is_down_reports_it(tmp_path):
    """The child process ends with one clear line, and another one may be started."""
    path = tmp_path / "cell.yaml"
    path.write_text(DEMO.read_text(encoding="utf-8").replace("7447", "7399"), encoding="utf-8")
    wizard = WizardProcess(path)
    asked: dict[str, Any] = {"poses": 6, "verify_poses": 1, "speed_mm_s": 100.0}
    assert wizard.plan(**asked) == ""
    assert wizard.plan(**asked) == "a calibration is already running"
    wizard.wait(60.0)
    assert wizard.progress.phase == "failed"
    assert "no hub" in " ".join(wizard.progress.notes)
    wizard.close()

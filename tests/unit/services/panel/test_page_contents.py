"""The panel's view of received messages: plots, log of faults, progress of the wizard."""

from html import escape

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.convert import vec3
from common.motion.frames import rotation_from_vector
from forcemesh.bus import Reading
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import (
    ArbiterStatus,
    RegulatorTarget,
    RobotState,
    WrenchAtTcp,
)
from forcemesh.requests import ForceStartRequest
from services.panel.faultlog import FAULTS_KEPT, FaultLog
from services.panel.readout import NAMES, Readout
from services.panel.tabs.faults import SHOWN, log_text
from services.panel.tabs.force import start_question
from services.panel.watch import Snapshot
from tests.fakes.bench import CELL

numbers = st.floats(-1e4, 1e4)


def received(message, fault=""):
    """Return a reading of a fresh message, or of one with a fault."""
    return Reading(message, None, 0.004, fault, silent="stale" in fault)


# --- plots ----------------------------------------------------------------------------------------


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

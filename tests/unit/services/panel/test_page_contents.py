"""The panel's view of received messages: plots, log of faults, progress of the wizard."""

from html import escape

from hypothesis import given
from hypothesis import strategies as st

from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import (
    ArbiterStatus,
)
from forcemesh.requests import ForceStartRequest
from services.panel.faultlog import FAULTS_KEPT, FaultLog
from services.panel.tabs.faults import SHOWN, log_text
from services.panel.tabs.force import start_question

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

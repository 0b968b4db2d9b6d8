"""Contact events in a report: recorded, read back and listed, each state once and in full."""

from pathlib import Path
from typing import Any

import pytest

from cli.report.contacts import ContactLog
from cli.report.data import report_content
from forcemesh import topics
from forcemesh.codec import Header
from forcemesh.messages import ContactEvent
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, PathRequest
from services.recorder.reading import RecordedFile
from tests.fakes.recorded_cell import READY_S, RecordedCell

PRESS = ForceStartRequest(
    mode="position", setpoint_N=10.0, law="adaptive", axes=(False, False, True) * 2
)
JOB = ["approach", "impact", "contact", "sliding", "contact", "lost", "free"]


def header(seq: int, epoch: int = 1) -> Header:
    """Return the header of a message."""
    return Header(seq=seq, epoch=epoch, boot="b", stamp_ns=seq, topic="demo/contact")


def event(number: int, **values: Any) -> ContactEvent:
    """Return a state, by default a contact."""
    return ContactEvent(number=number, **{"state": "contact", **values})


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a tool that presses, slides and leaves."""
    cell = RecordedCell(tmp_path_factory.mktemp("contacts"))
    cell.world.advance(READY_S)
    cell.record("slide")
    x, y, z = cell.world.arm.T_base_tcp.translation
    path = PathRequest(points_m=((x, y + 0.01, z),), speed_m_s=0.02)
    cell.play((
        (topics.TARE, Empty(), 0.1), (topics.ARM, ArmRequest(), 0.1),
        (topics.FORCE_START, PRESS, 2.0), (topics.FORCE_PATH, path, 1.5),
        (topics.FORCE_START, PRESS.replaced(setpoint_N=0.0), 0.6),
        (topics.FORCE_STOP, Empty(), 1.0),
    ))  # fmt: skip
    return cell.stop("slide")


def test_the_states_of_a_job_are_read_back(recording: Path) -> None:
    """Exactly those of the job; each with its whole duration and peak force."""
    read = RecordedFile(recording)
    assert read.cell is not None
    log = report_content(read, read.cell).contacts
    states = [each.state for _, each in log.states]
    assert states[-len(JOB) :] == JOB
    for (began_s, before), (next_s, after) in zip(log.states, log.states[1:], strict=False):
        assert after.number == before.number + 1
        assert before.duration_s == after.before_s
        assert before.peak_N == after.before_peak_N
        if before.duration_s > 0.06 and before.number > 1:
            assert next_s - began_s == pytest.approx(before.duration_s, abs=0.06)


def test_a_message_repeats_a_state_and_the_next_state_completes_it() -> None:
    """The last repetition is up to a period older than the end of the state.

    After a gap or a restart the next message is about another state.
    """
    log = ContactLog()
    log.add(1.0, header(1), event(4, duration_s=0.2, peak_N=3.0))
    log.add(1.1, header(2), event(4, duration_s=0.3, peak_N=5.0))
    log.add(1.2, header(3), event(5, state="lost", before_s=0.39, before_peak_N=6.0))
    (began_s, contact), (lost_s, lost) = log.states
    assert (began_s, lost_s, lost.state) == (pytest.approx(0.8), 1.2, "lost")
    assert (contact.duration_s, contact.peak_N) == (0.39, 6.0)
    log.add(2.0, header(9), event(7, before_s=9.0))
    log.add(3.0, header(1, epoch=2), event(7, before_s=5.0))
    log.add(4.0, header(1, epoch=3), event(8, before_s=7.0))
    assert [each.duration_s for _, each in log.states[1:]] == [0.0, 0.0, 0.0, 0.0]

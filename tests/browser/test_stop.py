"""Reports of the page on Stop motion when the reply is late or lost, and the state of the cell."""

import threading
from types import SimpleNamespace

import pytest

from forcemesh.bus import Reading
from forcemesh.errors import BusError
from forcemesh.messages import ArbiterState, ArbiterStatus
from forcemesh.requests import Reply
from services.panel.watch import Snapshot
from tests.browser.scripted import ScriptedWatch, served

pytestmark = [pytest.mark.browser, pytest.mark.long, pytest.mark.timeout(300)]

SILENCE_S = 60.0  # longer than the page waits before its report


class StoppedWatch(ScriptedWatch):
    """A cell in a given state that answers a hold as the test defines."""

    def __init__(self, state: ArbiterState, hold) -> None:
        super().__init__(Snapshot())
        self.state = state
        self.client = SimpleNamespace(hold=hold, feed=self.feed)

    def snapshot(self) -> Snapshot:
        """Return the present state."""
        status = ArbiterStatus(state=self.state)
        fresh = Reading(status, None, 0.01, "", silent=False)
        return Snapshot(now_ns=self.clock.now_ns(), hub_fault="", arbiter=fresh)


def lost(_reason):
    """Hold, without a reply."""
    raise BusError("no answer to request/hold within 2 s")


def stop_report(page) -> str:
    """Return the page's report on the stop."""
    return page.page.locator("#fm-said").inner_text()


def test_an_answer_that_is_lost_is_not_called_missing_where_the_arm_is_held(monkeypatch, cockpit):
    """The panel reads the state before its report."""
    with served(monkeypatch, StoppedWatch("HOLDING", lost)) as address:
        page = cockpit().open(address)
        page.until_state("HOLDING")
        page.page.keyboard.press("Shift+S")
        page.page.get_by_text("the arm is held (state HOLDING)").wait_for()
        assert "NO ANSWER" not in stop_report(page)


def test_the_report_no_answer_is_removed_when_the_arm_is_held(monkeypatch, cockpit):
    """No reply, and the arm may move: NO ANSWER, until the state reports the hold."""
    watch = StoppedWatch("ACTIVE", lost)
    with served(monkeypatch, watch) as address:
        page = cockpit().open(address)
        page.until_state("ACTIVE")
        page.page.keyboard.press("Shift+S")
        page.page.get_by_text("NO ANSWER from the cell").wait_for()
        watch.state = "HOLDING"
        page.page.get_by_text("corrected: the arm is held (state HOLDING)").wait_for()
        assert "NO ANSWER" not in stop_report(page)


@pytest.mark.parametrize("state", ["HOLDING", "ACTIVE"])
def test_a_panel_that_is_slow_to_answer_is_judged_by_the_state(monkeypatch, cockpit, state):
    """Held: reported as held. Not held: NO ANSWER; and the reply counts, however late it is."""
    answered = threading.Event()

    def late(_reason):
        answered.wait(SILENCE_S)
        return Reply(accepted=True, text="holding at last")

    with served(monkeypatch, StoppedWatch(state, late)) as address:
        page = cockpit().open(address)
        page.until_state(state)
        page.page.keyboard.press("Shift+S")
        if state == "HOLDING":
            page.page.get_by_text("the arm is held (state HOLDING)").wait_for()
            answered.set()
        else:
            page.page.get_by_text("NO ANSWER from the panel").wait_for()
            answered.set()
            page.page.get_by_text("Stop motion: holding at last").wait_for()
        assert "NO ANSWER" not in stop_report(page)

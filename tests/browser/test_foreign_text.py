"""Text of other processes in a real browser: shown character by character, never executed.

The page is served by this process from snapshots of its own, so no cell is needed.
"""

from types import SimpleNamespace

import pytest

from forcemesh.errors import RefusedError
from forcemesh.messages import RecorderStatus
from forcemesh.requests import Reply
from services.panel.wizard import Progress
from tests.browser.scripted import ScriptedWatch, feed_of, served
from tests.fakes.hostile_text import filled, hostile, reading, snapshot, texts_of

pytestmark = [pytest.mark.browser, pytest.mark.long, pytest.mark.timeout(300)]

READY = {  # tab: its elements for this cell
    "Force": "not calibrated",
    "Move": "flange",
    "Calibrate": "running:",
    "Record": "recording for",
    "Faults": "not ready:",
}
FORMS = "xpath=ancestor::*[@role='tablist'][1]/../.."
FOREIGN = "#x, iframe, object, embed, a[href*='example'], img[src*='passwd'], em, del, h1, strong"


def refuse(*_args, **_named):
    """Refuse a request with such texts."""
    reply = filled(Reply, hostile)
    raise RefusedError(reply.code, reply.text, remedy=hostile("remedy"))


def calibrating() -> Progress:
    """Return a calibration in which every text is foreign."""
    progress = Progress()
    progress.update({"note": hostile("note")})
    found = [[hostile("found"), hostile("value"), hostile("deviation")]]
    left = {"fit_N": [], "fresh_N": [], "limit_N": 1.0, "verdict": hostile("verdict")}
    progress.update({"left": left | {"found": found}})
    progress.update({"progress": 0.5, "text": hostile("progress")})
    return progress


def test_foreign_text_is_shown_as_text_and_makes_no_element(monkeypatch, cockpit):
    """Each field is shown complete, in the tabs, the bar and a reply."""
    watch = ScriptedWatch(snapshot(hostile))
    recorder = feed_of(reading(filled(RecorderStatus, hostile).replaced(recording=True)))
    watch.client = SimpleNamespace(
        tare=refuse, force=SimpleNamespace(gains=refuse), feed=lambda _topic: recorder
    )
    with served(monkeypatch, watch, calibrating()) as address:
        page = cockpit().open(address)
        page.click("Tare")
        page.until_reply("Tare")
        shown = ""
        for tab, shown_there in READY.items():
            page.tab(tab)
            panel = page.page.get_by_role("tab", name="Faults").locator(FORMS)
            panel.get_by_text(shown_there).first.wait_for()
            assert page.page.locator(FOREIGN).count() == 0
            shown += panel.evaluate("e => e.textContent")
        shown += page.page.evaluate("document.body.textContent")
        title = page.page.evaluate("document.querySelector('#fm-state').title")
        assert page.page.evaluate("window.ran") is None
    received = snapshot(hostile)
    status, wrench = received.arbiter.message, received.wrench.message
    assert status is not None
    assert wrench is not None
    named = ("note", "found", "deviation", "verdict", "progress", "RecorderStatus.cause")
    texts = {
        *(text for text in texts_of(status.trips) if ".unit" not in text),  # no text of its own
        *texts_of(status.not_ready),
        status.clears,
        *(one.fault for one in received.health.values()),
        wrench.calibration_fault,
        *(hostile(name) for name in (*named, "Reply.text")),
    }
    for text in texts:
        assert text in shown, text[:40]
    assert status.trips[0].text in title

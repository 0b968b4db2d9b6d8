"""Text of other processes in a real browser: shown character by character, never executed.

The page is served by this process from snapshots of its own, so no cell is needed.
"""

from types import SimpleNamespace

import pytest

from forcemesh import topics
from forcemesh.errors import RefusedError
from forcemesh.messages import RecorderStatus
from forcemesh.requests import Reply
from services.panel.wizard import Progress
from tests.browser.scripted import ScriptedWatch, feed_of, served
from tests.fakes.hostile_text import filled, harmless, hostile, reading, snapshot, texts_of

pytestmark = [pytest.mark.browser, pytest.mark.long, pytest.mark.timeout(300)]

READY = {  # tab: its elements for this cell
    "Force": "not calibrated",
    "Move": "flange",
    "Calibrate": "running:",
    "Record": "recording for",
    "Faults": "not ready:",
}
TAGS = "e => [...e.querySelectorAll('*')].map(one => one.tagName + '#' + (one.id ? 'id' : ''))"
FORMS = "xpath=ancestor::*[@role='tablist'][1]/../.."
FOREIGN = "#x, iframe, object, embed, a[href*='example'], img[src*='passwd'], em, del, h1, strong"


def watch_with(text) -> ScriptedWatch:
    """Return a watch on a cell that publishes such texts, also in every refusal."""

    def refuse(*_args, **_named):
        reply = filled(Reply, text)
        raise RefusedError(reply.code, reply.text, remedy=text("remedy"))

    watch = ScriptedWatch(snapshot(text))
    status = filled(RecorderStatus, text).replaced(recording=True)
    watch.client = SimpleNamespace(
        tare=refuse,
        clear=refuse,
        hold=refuse,
        force=SimpleNamespace(gains=refuse),
        feed=lambda _topic: feed_of(reading(status)),
    )
    return watch


def calibrating(text) -> Progress:
    """Return a calibration in which every text is foreign."""
    progress = Progress()
    progress.update({"note": text("note")})
    found = [[text("found"), text("value"), text("deviation")]]
    left = {"fit_N": [], "fresh_N": [], "limit_N": 1.0, "verdict": text("verdict"), "found": found}
    progress.update({"left": left})
    progress.update({"progress": 0.5, "text": text("progress")})
    return progress


def shown(cockpit, address):
    """Return the elements and the text of each tab, and the page."""
    page = cockpit().open(address)
    page.click("Tare")
    page.until_reply("Tare")
    tags, texts = {}, {}
    for tab, shown_there in READY.items():
        page.tab(tab)
        panel = page.page.get_by_role("tab", name="Faults").locator(FORMS)
        panel.get_by_text(shown_there).first.wait_for()
        tags[tab] = panel.evaluate(TAGS)
        texts[tab] = panel.evaluate("e => e.textContent")
    texts["all"] = "\n".join([*texts.values(), page.page.evaluate("document.body.textContent")])
    texts["title"] = page.page.evaluate("document.querySelector('#fm-state').title")
    return tags, texts, page


def test_foreign_text_is_shown_as_text_and_makes_no_element(monkeypatch, cockpit):
    """The elements are the same as with harmless text; each field is shown complete."""
    with served(monkeypatch, watch_with(harmless), calibrating(harmless)) as address:
        expected, harmless_texts, _ = shown(cockpit, address)
    with served(monkeypatch, watch_with(hostile), calibrating(hostile)) as address:
        tags, texts, page = shown(cockpit, address)
        assert page.page.locator(FOREIGN).count() == 0
        assert page.page.evaluate("window.ran") is None
        page.picture("panel-foreign")
    assert tags == expected
    received = snapshot(hostile)
    status, wrench = received.arbiter.message, received.wrench.message
    assert status is not None
    assert wrench is not None
    named = {
        *(text for text in texts_of(status.trips) if ".unit" not in text),  # no text of its own
        *texts_of(status.not_ready),
        status.clears,
        *(one.fault for one in received.health.values()),
        wrench.calibration_fault,
        hostile("note"),
        hostile("found"),
        hostile("deviation"),
        hostile("verdict"),
        hostile("progress"),
        hostile("RecorderStatus.cause"),
        hostile("Reply.text"),
    }
    for text in named:
        assert text in texts["all"], text[:40]
    assert status.trips[0].text in texts["title"]
    assert set(harmless_texts) == set(texts)


def test_every_message_with_a_text_is_among_them():
    """A field that is added to a message is filled, too."""
    for topic in topics.TOPICS:
        message = filled(topic.message, hostile)
        assert texts_of(message)
        assert all(len(text) == 500 for text in texts_of(message) if "<b" in text)

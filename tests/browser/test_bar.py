"""The page in front of a scripted cell: its bar, its settings, and reports of Stop motion."""

import re
import threading
from types import SimpleNamespace
from typing import get_args

import pytest

from forcemesh.bus import Reading
from forcemesh.errors import BusError
from forcemesh.faults import tripped
from forcemesh.messages import (
    ArbiterState,
    ArbiterStatus,
    Gains,
    Health,
    RegulatorTarget,
    RobotState,
    WrenchAtTcp,
)
from forcemesh.requests import Reply
from forcemesh.topics import HELPERS, ROLES
from services.panel.watch import Snapshot
from tests.browser.rig import hit, wait_until
from tests.browser.scripted import ScriptedWatch, served

pytestmark = [pytest.mark.browser, pytest.mark.long, pytest.mark.timeout(300)]

SECRET = "0123456789abcdef"  # noqa: S105 - of a panel of this test
SILENCE_S = 60.0  # longer than the page waits before its report
LEGIBLE_PX = 50  # at 2 m: digits of 10 mm, a two-hundredth of the distance
LOW = "TCP z = -412.3 mm is outside the workspace"
TRIPS = (
    tripped("workspace", LOW, value=-0.4123, limit=-0.4, unit="m"),
    tripped("force", "force 61.2 N is above the ceiling", value=61.2, limit=60.0, unit="N"),
)
CLEARS = (
    "move the arm back into the workspace with `forcemesh back-off`, clear the stop, "
    "and arm again when the path is clear"
)
NOT_READY = (
    "the last tare is 11.3 h old, force.tare_age_max_s allows 8.0 h",
    "inputs have been good for 0.4 s, 1 s are required",
)
OWNERS = {"commander": "regulator", "next_commander": "operator", "armed_for": "back_off"}
LONG = (
    ArbiterStatus.from_dict({"state": "ARMED", **OWNERS}),
    ArbiterStatus(state="IDLE", not_ready=NOT_READY),
    ArbiterStatus(state="HOLDING", trips=TRIPS, clears=CLEARS),
)
SIZES = ((1024, 768), (1200, 800), (1920, 1080))
# Elements of the bar that leave the window, hide a part of their text, or cover each other.
CUT_OFF = """() => {
  const all = [...document.querySelectorAll('#fm *')].filter(e => e.getClientRects().length);
  return all.filter(e => {
    const box = e.getBoundingClientRect(), next = e.nextElementSibling?.getBoundingClientRect();
    const around = e.parentElement.getBoundingClientRect();
    if (box.right > around.right + 1 || box.left < around.left - 1 || box.bottom > 129) return true;
    if (getComputedStyle(e).display === 'inline') return false;
    const hides = e.scrollWidth > e.clientWidth + 1;
    const scrolls = e.id === 'fm-why' && e.scrollHeight > e.clientHeight + 1;
    const beside = next?.width && next.left > box.left && next.top < box.bottom - 1;
    return hides || scrolls || (beside && next.left < box.right - 1);
  }).map(e => `${e.id || e.tagName}: ${e.textContent}`);
}"""
SIZE_PX = "parseFloat(getComputedStyle(document.querySelector('#fm-value')).fontSize)"
COLOUR = "getComputedStyle(document.querySelector('#fm-state')).backgroundColor"
DARK = "html[data-mantine-color-scheme=dark]"


def received(message, fault="", age_s=0.004):
    """Return a reading of a message."""
    return Reading(message, None, age_s, fault, silent="stale" in fault)


def snapshot(status, **more):
    """Return a snapshot in which the arbiter has this status and every service is present."""
    health = {name: received(Health(rate_hz=250.0)) for name in (*ROLES, *HELPERS)}
    wrench = received(WrenchAtTcp(force_N=(0.0, 0.0, -24.9), calibrated=True))
    readings = {"robot": received(RobotState()), "wrench": wrench, "health": health}
    return Snapshot(hub_fault="", arbiter=received(status), **(readings | more))


def watch_on(status, hold=None, **more) -> ScriptedWatch:
    """Return a watch whose cell answers requests for gains, and those to hold as given."""
    watch = ScriptedWatch(snapshot(status, **more))
    watch.client.force, watch.client.hold = SimpleNamespace(gains=Gains), hold
    return watch


def pressing(setpoint_N: float) -> Reading[RegulatorTarget]:
    """Return a press."""
    return received(RegulatorTarget(mode="position", law="plain", setpoint_N=setpoint_N))


def shows(page, place: str, text: str) -> None:
    """Wait until a place of the bar has exactly this text."""
    page.page.locator(f"#fm-{place}", has_text=re.compile(f"^{re.escape(text)}$")).wait_for()


def test_nothing_of_the_bar_is_cut_off_on_screens_of_labs(monkeypatch, cockpit):
    """Also with two trips, their values and their remedy, a long state, and while pressing."""
    watch, target = watch_on(LONG[0]), pressing(125.0)
    with served(monkeypatch, watch) as address:
        for width, height in SIZES:
            page = cockpit(width, height).open(address)
            for status in LONG:
                watch.received = snapshot(status, target=target)
                page.until_state(status.state)
                shows(page, "setpoint", "125.0 N")
                assert page.page.evaluate(CUT_OFF) == [], (width, status)
            cause = page.page.locator("#fm-cause").inner_text()
            assert "outside the workspace (-412.3 mm, limit -400 mm)" in cause
            assert "above the ceiling (61.2 N, limit 60 N)" in cause
            assert "forcemesh back-off" in page.page.locator("#fm-remedy").inner_text()
            page.tab("Faults")
            page.until_reply("(61.2 N, limit 60 N)")


def test_force_and_state_are_legible_from_two_metres(monkeypatch, cockpit):
    """Digits of 10 mm, none once the wrench is stale or the panel gone; a colour for each state."""
    active = ArbiterStatus(state="ACTIVE", commander="regulator")
    watch = watch_on(active, target=pressing(25.0))
    with served(monkeypatch, watch) as address:
        page = cockpit(1200, 800).open(address)
        shows(page, "value", "24.9 N")
        shows(page, "setpoint", "25.0 N")
        assert page.page.evaluate(SIZE_PX) >= LEGIBLE_PX
        watch.received = snapshot(active, wrench=received(WrenchAtTcp(), "wrench stale", 2.31))
        shows(page, "value", "no data for 2.3 s")
        assert page.page.locator("#fm-goal").is_hidden()
        colours = {}
        for state in get_args(ArbiterState):
            watch.received = snapshot(ArbiterStatus(state=state))
            page.until_state(state)
            colours[state] = page.page.evaluate(COLOUR)
        assert len(set(colours.values())) == len(get_args(ArbiterState)), colours
    page.until_state("panel does not answer")  # it has ended
    shows(page, "value", "no data")
    hit(page.page.locator("#fm-stop"))
    page.page.get_by_text("NO ANSWER from the panel").wait_for()


def test_dark_mode_is_stored_and_the_page_contacts_no_other_host(monkeypatch, cockpit):
    """It is in the settings only, as viser's note on drawing, which does not cover the scene."""
    with served(monkeypatch, watch_on(LONG[0])) as address:
        page = cockpit().open(address)
        for tab in ("Force", "Move", "Calibrate", "Record", "Faults"):
            page.tab(tab)
            assert page.page.locator("label:visible", has_text="Dark mode").count() == 0
        note = page.page.locator("#webgl-software-rendering")
        note.wait_for(state="attached")
        assert note.is_hidden()
        assert page.page.locator(".fm-software:visible").count() == 0
        page.tab("Settings")
        wait_until(lambda: page.page.locator("label:visible", has_text="Dark mode").count() == 1)
        page.page.locator(".fm-software:visible").wait_for()
        hit(page.page.get_by_role("checkbox").last)
        page.page.locator(DARK).wait_for()
        page.open(address)
        page.page.locator(DARK).wait_for()
        out = "fetch('http://192.0.2.1/').then(() => 'asked', () => 'refused')"
        assert page.page.evaluate(out) == "refused"


def test_a_view_only_session_shows_everything_and_commands_nothing(monkeypatch, cockpit):
    """Behind a token: no form, no Stop motion, and no server function."""
    with served(monkeypatch, watch_on(LONG[0]), token=SECRET, view_only=True) as address:
        page = cockpit()
        page.page.goto(address)
        page.page.locator("input[type=password]").fill(SECRET)
        hit(page.page.get_by_role("button", name="Open"))
        page.page.get_by_text("View only: this session has no operator rights.").wait_for()
        page.until_state("ARMED")
        assert SECRET not in page.page.url
        assert page.page.locator("#fm-mode").inner_text() == "SIMULATION · view only"
        assert page.page.locator("#fm-stop").is_hidden()
        assert page.page.get_by_role("tab", name="Force").count() == 0
        request_stop = "fetch('/stop', {headers: {'X-Forcemesh': '1'}}).then(reply => reply.json())"
        expected = {"text": "refused: this page is view-only", "answered": True}
        assert page.page.evaluate(request_stop) == expected


# --- Stop motion ----------------------------------------------------------------------------------


def test_a_phone_shows_what_matters_and_its_stop_button_works(monkeypatch, cockpit):
    """State and Stop motion are visible, nothing is wider than the screen, a thumb can stop."""

    def hold(_reason):
        watch.received = snapshot(ArbiterStatus(state="HOLDING"))
        return Reply(accepted=True, text="held")

    watch = watch_on(ArbiterStatus(state="ARMED"), hold)
    with served(monkeypatch, watch) as address:
        page = cockpit(390, 844, has_touch=True, is_mobile=True, device_scale_factor=2.0)
        page.open(address).until_state("ARMED")
        box = page.page.locator("#fm-stop").bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
        assert box["height"] >= 36
        assert page.page.evaluate("document.documentElement.scrollWidth") <= 390
        page.picture("panel-phone")
        page.page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.until_state("HOLDING")


def lost(_reason):
    """Hold, without a reply."""
    raise BusError("no answer to request/hold within 2 s")


@pytest.mark.parametrize("state", ["HOLDING", "ACTIVE"])
def test_a_reply_that_is_lost_is_called_missing_only_while_the_arm_may_move(
    monkeypatch, cockpit, state
):
    """The panel reads the state before its report, and corrects it when the arm is held."""
    watch = watch_on(ArbiterStatus(state=state), lost)
    with served(monkeypatch, watch) as address:
        page = cockpit().open(address)
        page.until_state(state)
        page.page.keyboard.press("Shift+S")
        if state == "ACTIVE":
            page.page.get_by_text("NO ANSWER from the cell").wait_for()
            watch.received = snapshot(ArbiterStatus(state="HOLDING"))
            page.page.get_by_text("corrected: the arm is held (state HOLDING)").wait_for()
        page.page.get_by_text("the arm is held (state HOLDING)").wait_for()
        assert "NO ANSWER" not in page.page.locator("#fm-said").inner_text()


@pytest.mark.parametrize(
    ("state", "report"),
    [("HOLDING", "the arm is held (state HOLDING)"), ("ACTIVE", "NO ANSWER from the panel")],
)
def test_a_panel_that_is_slow_to_answer_is_judged_by_the_state(monkeypatch, cockpit, state, report):
    """Held: reported as held. Not held: NO ANSWER; and the reply counts, however late it is."""
    answered = threading.Event()

    def late(_reason):
        answered.wait(SILENCE_S)
        return Reply(accepted=True, text="holding at last")

    with served(monkeypatch, watch_on(ArbiterStatus(state=state), late)) as address:
        page = cockpit().open(address)
        page.until_state(state)
        page.page.keyboard.press("Shift+S")
        page.page.get_by_text(report).wait_for()
        answered.set()
        if state == "ACTIVE":
            page.page.get_by_text("Stop motion: holding at last").wait_for()
        assert "NO ANSWER" not in page.page.locator("#fm-said").inner_text()

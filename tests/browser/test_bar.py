"""The bar above every page: force in large digits, colours of the states, nothing cut off."""

import re
from types import SimpleNamespace
from typing import get_args

import pytest

from forcemesh.bus import Reading
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
from forcemesh.topics import HELPERS, ROLES
from services.panel.watch import Snapshot
from tests.browser.rig import wait_until
from tests.browser.scripted import ScriptedWatch, served

pytestmark = [pytest.mark.browser, pytest.mark.long, pytest.mark.timeout(300)]

LEGIBLE_PX = 50  # at 2 m: digits of 10 mm, a two-hundredth of the distance
TRIPS = (
    tripped(
        "workspace",
        "TCP z = -412.3 mm is outside the workspace",
        value=-0.4123,
        limit=-0.4,
        unit="m",
    ),
    tripped("force", "force 61.2 N is above the ceiling", value=61.2, limit=60.0, unit="N"),
)
LONG = {
    "tripped": ArbiterStatus(
        state="HOLDING",
        trips=TRIPS,
        clears="move the arm back into the workspace with `forcemesh back-off`, clear the stop, "
        "and arm again when the path is clear",
    ),
    "owned": ArbiterStatus(
        state="ARMED", commander="regulator", next_commander="operator", armed_for="back_off"
    ),
    "not ready": ArbiterStatus(
        state="IDLE",
        not_ready=(
            "the last tare is 11.3 h old, force.tare_age_max_s allows 8.0 h",
            "inputs have been good for 0.4 s, 1 s are required",
        ),
    ),
}
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


def received(message, fault="", age_s=0.004):
    """Return a reading of a message."""
    return Reading(message, None, age_s, fault, silent="stale" in fault)


def snapshot(status, **more):
    """Return a snapshot in which the arbiter has this status and every service is present."""
    health = {name: received(Health(rate_hz=250.0)) for name in (*ROLES, *HELPERS)}
    wrench = received(WrenchAtTcp(force_N=(0.0, 0.0, -24.9), calibrated=True))
    readings = {"robot": received(RobotState()), "wrench": wrench, "health": health}
    return Snapshot(hub_fault="", arbiter=received(status), **(readings | more))


def watch_on(current) -> ScriptedWatch:
    """Return a watch whose regulator answers the request for gains."""
    watch = ScriptedWatch(current)
    watch.client.force = SimpleNamespace(gains=Gains)
    return watch


def shows(page, place: str, text: str) -> None:
    """Wait until a place of the bar has exactly this text."""
    page.page.locator(f"#fm-{place}", has_text=re.compile(f"^{re.escape(text)}$")).wait_for()


def test_nothing_of_the_bar_is_cut_off_on_screens_of_labs(monkeypatch, cockpit):
    """Also with two trips and their remedy, a long state, and while pressing."""
    watch = watch_on(Snapshot())
    target = received(RegulatorTarget(mode="position", law="plain", setpoint_N=125.0))
    with served(monkeypatch, watch) as address:
        for width, height in SIZES:
            page = cockpit(width, height).open(address)
            for status in LONG.values():
                watch.received = snapshot(status, target=target)
                page.until_state(status.state)
                shows(page, "setpoint", "125.0 N")
                assert page.page.evaluate(CUT_OFF) == [], (width, status)


def test_the_force_is_legible_from_two_metres_and_never_a_zero_without_data(monkeypatch, cockpit):
    """Digits of 10 mm; with the set point while it presses; no digit once the wrench is stale."""
    status = ArbiterStatus(state="ACTIVE", commander="regulator")
    target = received(RegulatorTarget(mode="position", law="plain", setpoint_N=25.0))
    watch = watch_on(snapshot(status, target=target))
    with served(monkeypatch, watch) as address:
        page = cockpit(1200, 800).open(address)
        shows(page, "value", "24.9 N")
        shows(page, "setpoint", "25.0 N")
        assert page.page.evaluate(SIZE_PX) >= LEGIBLE_PX
        watch.received = snapshot(
            status, wrench=received(WrenchAtTcp(), "wrench stale", age_s=2.31)
        )
        shows(page, "value", "no data for 2.3 s")
        assert page.page.locator("#fm-goal").is_hidden()
    shows(page, "value", "no data")  # the panel has ended


def test_each_state_has_its_colour_and_its_word(monkeypatch, cockpit):
    """ARMED has another colour than ACTIVE."""
    watch = watch_on(Snapshot())
    colour = "getComputedStyle(document.querySelector('#fm-state')).backgroundColor"
    with served(monkeypatch, watch) as address:
        page = cockpit().open(address)
        colours = {}
        for state in get_args(ArbiterState):
            watch.received = snapshot(ArbiterStatus(state=state))
            page.until_state(state)
            colours[state] = page.page.evaluate(colour)
    assert len(set(colours.values())) == len(get_args(ArbiterState)), colours


def test_a_trip_is_shown_with_its_value_limit_and_remedy(monkeypatch, cockpit):
    """On the page itself, and in the tab Faults."""
    with served(monkeypatch, watch_on(snapshot(LONG["tripped"]))) as address:
        page = cockpit().open(address)
        page.until_state("HOLDING")
        cause = page.page.locator("#fm-cause").inner_text()
        assert "outside the workspace (-412.3 mm, limit -400 mm)" in cause
        assert "above the ceiling (61.2 N, limit 60 N)" in cause
        assert "forcemesh back-off" in page.page.locator("#fm-remedy").inner_text()
        page.tab("Faults")
        page.until_reply("(61.2 N, limit 60 N)")


def test_dark_mode_and_the_note_on_drawing_are_in_the_settings_only(monkeypatch, cockpit):
    """The note of viser does not cover the scene; this browser has no graphics card."""
    with served(monkeypatch, watch_on(snapshot(LONG["owned"]))) as address:
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

"""The panel in a real browser on the simulated cell: permitted and refused actions of a person."""

import os
import re
import signal
from pathlib import Path

import pytest
from playwright.sync_api import expect

from common.config.calibration import CalibrationSection
from common.config.load import load_cell
from launch.run_file import Run
from tests.browser.rig import PATIENCE_S, answers, hit, running, wait_until
from tests.chaos.common_net import free_port

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.browser,
    pytest.mark.long,
    pytest.mark.timeout(400),
]

SECRET = "0123456789abcdef"  # noqa: S105 - of a panel of this test


def test_a_person_presses_and_the_force_follows_the_set_point(ready, address, cockpit):
    """Arm, read the forecast, press, change the set point; each move needs a confirmation."""
    page = cockpit(1440, 860).open(address)
    page.click("Arm")
    page.button("Arm now").wait_for()
    assert ready.status().state == "IDLE"  # one click moves nothing
    page.cancel()
    page.arm()
    page.fill("Set point [N]", 15.0)
    page.page.get_by_text("forecast: settles").wait_for()
    page.click("Start pressing")
    assert ready.target.reading().fresh is None
    page.click("Press now")
    wait_until(lambda: ready.force.pressed_N() > 14.0)
    page.fill("Set point [N]", 25.0)
    page.click("Change set point")
    wait_until(lambda: ready.force.pressed_N() > 24.0)
    assert page.page.locator(".uplot canvas").count() == 4
    page.picture("panel")
    page.click("Stop force feedback")
    page.until_reply("force feedback is off")
    assert ready.status().state == "ARMED"


def test_a_task_is_started_by_its_six_rows_and_shown_in_a_table(ready, address, cockpit):
    """Force along z, admittance along x is refused until axes are verified; the table is live."""
    page = cockpit(1440, 1100).open(address)
    page.arm()
    hit(page.page.get_by_text("Axes", exact=True).first)
    page.choose("z", "force")
    page.fill("z set point [N]", 10.0)
    page.choose("x", "free")
    page.click("Start axes")
    page.click("Start now")
    page.until_reply("Start axes: refused")  # the sensor's axes are not verified
    page.choose("x", "held")
    page.click("Start axes")
    page.click("Start now")
    wait_until(lambda: ready.force.pressed_N() > 9.0)
    row = page.page.locator("tr:visible", has_text=re.compile(r"^zforce10\.00"))
    row.wait_for()
    page.picture("panel-axes")


def test_tare_is_refused_in_contact_and_done_in_free_space(ready, address, cockpit):
    """The reply is shown, with the remedy."""
    page = cockpit().open(address)
    page.click("Tare")
    page.until_reply("Tare: done")
    page.arm()
    page.press()
    wait_until(lambda: ready.force.pressed_N() > 14.0)
    page.click("Tare")
    page.until_reply("Tare: refused")


@pytest.mark.parametrize("control", ["button", "key"])
def test_stop_motion_holds_even_over_an_open_question(ready, address, cockpit, control):
    """The button is above every dialog, the key works everywhere; clearing is a separate step."""
    page = cockpit().open(address)
    page.arm()
    page.press()
    page.tab("Move")
    page.click("Unlock jogging")
    page.button("Unlock").wait_for()
    if control == "button":
        hit(page.page.locator("#fm-stop"))
    else:
        page.page.keyboard.press("Shift+S")
    wait_until(lambda: ready.status().state == "HOLDING")
    assert "Stop motion was pressed in the panel" in ready.status().trips[0].text
    page.until_state("HOLDING")
    page.cancel()
    page.tab("Faults")
    page.until_reply("Stop motion was pressed in the panel")
    page.until_reply("arm again when the path is clear")
    page.click("Clear")
    page.until_state("IDLE")


def test_a_fault_is_shown_with_its_remedy_and_recovered_from(ready, cell_file, address, cockpit):
    """A frozen service: the arm stops, the page names it; afterwards clear and arm work."""
    page = cockpit().open(address)
    page.arm()
    run = Run.model_validate_json(next(cell_file.parent.glob("panel-*.json")).read_text())
    wrench = run.entry("wrench")
    assert wrench is not None
    os.kill(wrench.pid, signal.SIGSTOP)
    try:
        page.until_state("FAULT")
        page.tab("Faults")
        page.until_reply("wrench/health stale")
    finally:
        os.kill(wrench.pid, signal.SIGCONT)
    # Its health comes less often than its wrench, and until then the fault cannot be cleared.
    wait_until(lambda: not ready.wrench.reading().fault and "wrench" not in ready.silent())
    page.picture("panel-fault")
    page.click("Clear")
    page.until_state("IDLE")
    page.tab("Force")
    page.arm()


def test_an_arm_without_a_wrench_backs_off_by_5_mm_after_a_second_question(
    ready, cell_file, address, cockpit
):
    """Without a force signal: the first yes moves nothing, the second one 5 mm up, no farther."""
    page = cockpit().open(address)
    run = Run.model_validate_json(next(cell_file.parent.glob("panel-*.json")).read_text())
    wrench = run.entry("wrench")
    assert wrench is not None
    page.tab("Move")
    z_mm = 1e3 * ready.state().position_m[2]
    os.kill(wrench.pid, signal.SIGSTOP)
    try:
        wait_until(lambda: "wrench" in ready.silent())
        page.click("Back off")
        page.click("Back off now")
        page.until_reply("no force can be followed")
        page.button("Move 5 mm back").wait_for()
        assert abs(1e3 * ready.state().position_m[2] - z_mm) < 0.1
        page.picture("panel-back-off")
        page.click("Move 5 mm back")
        page.until_reply("full travel used: 5.0 mm")
    finally:
        os.kill(wrench.pid, signal.SIGCONT)
    assert abs(1e3 * ready.state().position_m[2] - z_mm - 5.0) < 0.5


def test_two_people_do_not_disturb_each_other(ready, address, cockpit):
    """A question is for its own session, forms show the cell and keep input, each can stop."""
    one, other = cockpit().open(address), cockpit().open(address)
    one.click("Arm")
    one.button("Arm now").wait_for()
    assert other.page.get_by_text("Arm now").count() == 0
    one.cancel()
    one.arm()
    other.until_state("ARMED")
    one.fill("Set point [N]", 7.0)
    one.press()
    wait_until(lambda: ready.force.pressed_N() > 6.0)
    shown = other.page.locator("input[inputmode]:visible").first
    expect(shown).to_have_value(
        re.compile(r"^7(\.0)?\b")
    )  # the cell's, not the other's own default
    other.fill("Set point [N]", 9.0)
    other.page.get_by_text("set point 7 N").wait_for()  # typed text stays, and changes nothing
    expect(shown).to_have_value(re.compile(r"^9(\.0)?\b"))
    other.page.keyboard.press("Shift+S")
    one.until_state("HOLDING")


def _method_of_calibration(cell_file: Path) -> str:
    found = load_cell(cell_file).calibration
    assert isinstance(found, CalibrationSection)
    return found.method


def test_jogging_is_unlocked_once_and_then_moves_at_each_click(ready, address, cockpit):
    """Until then there are no buttons; a step of 5 mm up is a step of 5 mm up."""
    page = cockpit().open(address)
    page.tab("Move")
    page.click("Arm for jog")
    page.click("Arm now")
    page.until_state("ARMED for jog")
    assert page.button("+z").count() == 0
    z_mm = 1e3 * ready.state().position_m[2]
    page.click("Unlock jogging")
    page.click("Unlock")
    page.click("+z")
    wait_until(lambda: abs(1e3 * ready.state().position_m[2] - z_mm - 5.0) < 0.1)
    page.picture("panel-move")


def test_from_nothing_to_a_calibrated_press_in_eight_clicks(ready, cell_file, address, cockpit):
    """The wizard to its end, then arm and press with 15 N: by the panel alone."""
    page = cockpit(1280, 900).open(address)
    page.tab("Calibrate")
    page.fill("Poses", 6)
    page.fill("Verification poses", 1)
    page.fill("Speed [mm/s]", 800)
    page.click("Calibrate")
    page.click("Move now")
    page.until_reply("running")
    wait_until(lambda: _method_of_calibration(cell_file) == "arm", 2.0 * PATIENCE_S)
    page.until_reply("the cell uses the new calibration")
    assert page.page.get_by_text("Residual force at each pose").is_visible()
    assert page.page.get_by_text("mass (kg)").is_visible()
    page.picture("panel-calibrate")
    page.tab("Force")
    page.arm()
    page.press()
    wait_until(lambda: ready.force.pressed_N() > 14.0)
    assert ready.wrench().calibrated
    assert page.clicks <= 8


def test_a_view_only_session_shows_everything_and_commands_nothing(ready, cell_file, cockpit):
    """A second panel with a token, view only: no form, no Stop motion, and no server function."""
    port = free_port()
    words = ("-m", "services.panel", "--cell", cell_file, "--port", port, "--view-only")
    with running(*words, FORCEMESH_PANEL_TOKEN=SECRET):
        wait_until(lambda: answers(port))
        page = cockpit()
        page.page.goto(f"http://127.0.0.1:{port}/")
        page.page.locator("input[type=password]").fill(SECRET)
        hit(page.page.get_by_role("button", name="Open"))
        page.page.get_by_text("View only: this session has no operator rights.").wait_for()
        page.until_state("IDLE")
        assert SECRET not in page.page.url
        assert page.page.locator("#fm-mode").inner_text() == "SIMULATION · view only"
        assert page.page.locator("#fm-stop").is_hidden()
        assert page.page.get_by_role("tab", name="Force").count() == 0
        request_stop = "fetch('/stop', {headers: {'X-Forcemesh': '1'}}).then(reply => reply.json())"
        expected = {"text": "refused: this page is view-only", "answered": True}
        assert page.page.evaluate(request_stop) == expected
        assert ready.status().state == "IDLE"


def test_a_phone_shows_what_matters_and_its_stop_button_works(ready, address, cockpit):
    """State and Stop motion are visible, nothing is wider than the screen, a thumb can stop."""
    page = cockpit(390, 844, has_touch=True, is_mobile=True, device_scale_factor=2.0)
    page.open(address)
    ready.arm("jog")
    page.until_state("ARMED")
    box = page.page.locator("#fm-stop").bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 390
    assert box["height"] >= 36
    assert page.page.evaluate("document.documentElement.scrollWidth") <= 390
    page.picture("panel-phone")
    page.page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.until_state("HOLDING")


def test_dark_mode_is_stored_and_the_page_contacts_no_other_host(ready, address, cockpit):
    """The browser keeps the choice, and its policy blocks requests to other machines."""
    page = cockpit().open(address)
    page.tab("Settings")
    hit(page.page.get_by_role("checkbox").last)
    page.page.locator("html[data-mantine-color-scheme=dark]").wait_for()
    page.picture("panel-dark")
    page.open(address)
    page.page.locator("html[data-mantine-color-scheme=dark]").wait_for()
    out = "fetch('http://192.0.2.1/').then(() => 'asked', () => 'refused')"
    assert page.page.evaluate(out) == "refused"


def test_an_ended_panel_is_shown_and_affects_no_other_process(ready, cell_file, cockpit):
    """The bar shows it, Stop motion reports that there is no answer, and the cell continues."""
    port = free_port()
    with running("-m", "services.panel", "--cell", cell_file, "--port", port) as panel:
        wait_until(lambda: answers(port))
        page = cockpit().open(f"http://127.0.0.1:{port}/")
        page.until_state("IDLE")
        panel.kill()
        page.until_state("panel does not answer")
        hit(page.page.locator("#fm-stop"))
        page.page.get_by_text("NO ANSWER from the panel").wait_for()
    assert not ready.silent()


def test_the_panel_is_started_by_up(cell, cell_file):
    """It has its own port, and its end does not end the cell."""
    run = Run.model_validate_json(next(cell_file.parent.glob("panel-*.json")).read_text())
    assert answers(cell.config.panel.port)
    helpers = {entry.module: entry.alive for entry in run.processes if entry.is_helper}
    assert helpers["services.panel"]
    assert Path(run.cell_file) == cell_file

"""The panel in a real browser on the simulated cell: permitted and refused actions of a person."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from common.config.calibration import CalibrationSection
from common.config.load import load_cell
from tests.browser.rig import PATIENCE_S, hit, wait_until

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.browser,
    pytest.mark.long,
    pytest.mark.timeout(400),
]


def test_a_person_presses_and_the_force_follows_the_set_point(ready, address, cockpit):
    """Tare, arm, read the forecast, press, change the set point; each move needs a confirmation."""
    page = cockpit(1440, 860).open(address)
    page.click("Tare")
    page.until_reply("Tare: done")
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
    page.click("Tare")
    page.until_reply("Tare: refused")  # in contact
    page.fill("Set point [N]", 25.0)
    page.click("Change set point")
    wait_until(lambda: ready.force.pressed_N() > 24.0)
    assert page.page.locator(".uplot canvas").count() == 4
    page.picture("panel")
    page.click("Stop force feedback")
    page.until_reply("force feedback is off")
    assert ready.status().state == "ARMED"


def test_a_task_is_started_by_its_six_rows_and_shown_in_a_table(ready, address, cockpit):
    """Force along z, free along x; what is too much is refused, and the table is live."""
    page = cockpit(1440, 1100).open(address)
    page.arm()
    hit(page.page.get_by_text("Axes", exact=True).first)
    page.choose("z", "force")
    page.fill("z set point [N]", 90.0)
    page.choose("x", "compliant")
    page.click("Start axes")
    page.click("Start now")
    page.until_reply("Start axes: refused")
    page.fill("z set point [N]", 10.0)
    page.click("Start axes")
    page.click("Start now")
    wait_until(lambda: ready.force.pressed_N() > 9.0)
    row = page.page.locator("tr:visible", has_text=re.compile(r"^zforce10\.00"))
    row.wait_for()


def test_stop_motion_holds_even_over_an_open_question(ready, address, cockpit):
    """The button is above every dialog; clearing is a separate step."""
    page = cockpit().open(address)
    page.arm()
    page.press()
    page.tab("Move")
    page.click("Unlock jogging")
    page.button("Unlock").wait_for()
    hit(page.page.locator("#fm-stop"))
    wait_until(lambda: ready.status().state == "HOLDING")
    assert "Stop motion was pressed in the panel" in ready.status().trips[0].text
    page.until_state("HOLDING")
    page.cancel()
    page.tab("Faults")
    page.until_reply("Stop motion was pressed in the panel")
    page.until_reply("arm again when the path is clear")
    page.click("Clear")
    page.until_state("IDLE")


def test_two_people_do_not_disturb_each_other(ready, address, cockpit):
    """A question is for its own session, forms show the cell and keep input, the key stops."""
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
    expect(shown).to_have_value(re.compile(r"^7(\.0)?\b"))  # the cell's, not its own default
    other.fill("Set point [N]", 9.0)
    other.page.get_by_text("set point 7 N").wait_for()  # typed text stays, and changes nothing
    expect(shown).to_have_value(re.compile(r"^9(\.0)?\b"))
    other.tab("Move")
    other.click("Unlock jogging")
    other.button("Unlock").wait_for()
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
    page.tab("Force")
    page.arm()
    page.press()
    wait_until(lambda: ready.force.pressed_N() > 14.0)
    assert ready.wrench().calibrated
    assert page.clicks <= 8

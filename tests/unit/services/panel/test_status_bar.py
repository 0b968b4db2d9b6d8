"""Status bar of the panel: state, cause, force, services, colours, and the reply to a stop."""

from dataclasses import replace
from itertools import combinations
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.convert import vec3
from common.motion.frames import rotation_from_vector
from forcemesh.bus import Reading
from forcemesh.faults import tripped
from forcemesh.messages import (
    ArbiterState,
    ArbiterStatus,
    ContactEvent,
    Health,
    RegulatorTarget,
    RobotState,
    WrenchAtTcp,
)
from services.panel.server import page
from services.panel.state_colours import NO_STATE, STATE_COLOURS
from services.panel.status_bar import UNANSWERED, force_display, held_as, stop_text, strip
from services.panel.tabs.faults import now_text
from services.panel.viewer import RequestOutcome
from services.panel.watch import Snapshot
from tests.fakes.bench import CELL
from tools.tree import ROOT


def fresh(message, fault="", *, silent=False, age_s=0.004):
    """Return a reading."""
    return Reading(message, None, age_s, fault, silent=silent)


def reached(**readings):
    """Return a snapshot of a cell with a hub."""
    return Snapshot(hub_fault="", **readings)


# --- colours --------------------------------------------------------------------------------------

EVERY_COLOUR = {"no state": NO_STATE, **STATE_COLOURS}
# Linear RGB for colour vision without one kind of cones: Machado et al., IEEE TVCG 15(6), 2009.
# fmt: off
VISION = {
    "all cones": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868],
                            [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968],
                              [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([[1.255528, -0.076749, -0.178779],
                            [-0.078411, 0.930809, 0.147602],
                            [0.004733, 0.691367, 0.303900]]),
}
RGB_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805],
                       [0.2126, 0.7152, 0.0722],
                       [0.0193, 0.1192, 0.9505]])
# fmt: on
WHITE_XYZ = np.array([0.9505, 1.0, 1.089])
MIN_DISTANCE = 15.0  # CIE 1976; about 2 is just noticeable
MIN_CONTRAST = 4.5  # WCAG 2.1, level AA


def linear(colour):
    """Return a CSS colour as linear RGB. Shape (3,)."""
    parts = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
    return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    """Return linear RGB as CIE L*a*b*. Shape (3,)."""
    x, y, z = np.cbrt(np.maximum(RGB_TO_XYZ @ np.clip(rgb, 0.0, 1.0) / WHITE_XYZ, 1e-4))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("vision", VISION)
def test_every_two_states_have_colours_that_differ_also_for_the_colour_blind(vision):
    """This matters most for ARMED and ACTIVE; the state's name is shown as well, and legible."""
    shown = {name: lab(VISION[vision] @ linear(each[0])) for name, each in EVERY_COLOUR.items()}
    for one, other in combinations(EVERY_COLOUR, 2):
        assert np.linalg.norm(shown[one] - shown[other]) > MIN_DISTANCE, (one, other)
    for name, colour in EVERY_COLOUR.items():
        low, high = sorted(RGB_TO_XYZ[1] @ linear(each) for each in colour)
        assert (high + 0.05) / (low + 0.05) > MIN_CONTRAST, name


def test_the_page_and_the_bar_take_their_colours_from_the_table():
    """A state has its colours, an unknown one those of the page."""
    assert f"background: {NO_STATE.background}; color: {NO_STATE.text};" in page("a title")
    assert list(STATE_COLOURS) == list(get_args(ArbiterState))
    for state in get_args(ArbiterState):
        received = reached(arbiter=fresh(ArbiterStatus(state=state)))
        assert strip(CELL, received, "view")["colour"] == STATE_COLOURS[state]._asdict()
    assert strip(CELL, Snapshot(), "view")["colour"] == NO_STATE._asdict()


# --- state, cause, commander, contact -------------------------------------------------------------

TRIPS = (
    tripped("force", "force 31.2 N is above the ceiling", value=31.2, limit=30.0, unit="N"),
    tripped("hold", "the operator asked"),
)
BOTH = "force 31.2 N is above the ceiling (31.2 N, limit 30 N); the operator asked"


@pytest.mark.parametrize(
    ("status", "shown"),
    [
        (None, {"state": "no arbiter status", "why": "missing", "who": "", "held": ""}),
        ({"state": "IDLE"}, {"state": "IDLE", "why": "", "who": "commander: none", "held": "IDLE"}),
        ({"not_ready": ("a", "b")}, {"why": "not ready: a; b", "remedy": ""}),
        (
            {"state": "HOLDING", "trips": TRIPS, "clears": "clear, then arm"},
            {"state": "HOLDING", "why": BOTH, "remedy": "clear, then arm", "held": "HOLDING"},
        ),
        (
            {"state": "ACTIVE", "commander": "regulator", "armed_for": "jog"},
            {"state": "ACTIVE for jog", "who": "commander: regulator", "held": ""},
        ),
        (
            {"commander": "regulator", "next_commander": "operator"},
            {"who": "commander: regulator, next: operator"},
        ),
    ],
)
def test_the_bar_shows_state_cause_remedy_and_commander(status, shown):
    """Every trip with its value and limit, on the page itself; nothing while nothing is known."""
    message = None if status is None else ArbiterStatus(**status)
    bar = strip(CELL, reached(arbiter=fresh(message, "" if message else "missing")), "operate")
    assert shown.items() <= bar.items()
    assert strip(CELL, Snapshot(), "operate")["state"] == "cell not reached"


@pytest.mark.parametrize(
    ("event", "fault", "text"),
    [
        (None, "missing", ""),
        (ContactEvent(valid=False), "wrench stale", ""),
        (ContactEvent(state="free", duration_s=12.34), "", "contact: free 12.3 s"),
        (
            ContactEvent(state="sliding", duration_s=2.31, peak_N=12.38),
            "",
            "contact: sliding 2.3 s, peak 12.4 N",
        ),
    ],
)
def test_the_bar_shows_the_contact_with_its_peak_force(event, fault, text):
    """Nothing is shown while it is unknown, and no peak without contact."""
    assert strip(CELL, reached(contact=fresh(event, fault)), "view")["contact"] == text


@pytest.mark.parametrize("monitor", [False, True])
def test_the_bar_shows_whether_the_arm_is_real_and_may_be_stopped(monitor):
    """An operator always may stop it; a view-only page where a certificate that only reads may."""
    bus = CELL.bus.model_copy(update={"monitor_may_hold": monitor})
    cell = CELL.model_copy(update={"bus": bus})
    assert strip(cell, Snapshot(), "operate")["may_stop"] is True
    assert strip(cell, Snapshot(), "view")["may_stop"] is monitor
    real = load_cell(ROOT / "cells" / "rs007l-real.yaml")
    assert [strip(each, Snapshot(), "view")["mode"] for each in (cell, real)] == [
        "SIMULATION",
        "REAL",
    ]


# --- services -------------------------------------------------------------------------------------


def test_the_bar_shows_each_service_with_its_rate_age_and_fault():
    """A cell without a recorder lacks nothing; one that has stopped is missing, also as a fault."""
    health = {
        "hub": fresh(Health(rate_hz=250.0)),
        "sensor": fresh(Health(rate_hz=500.0, fault="the cable is out")),
        "arbiter": fresh(None, "arbiter/health stale"),
        "recorder": fresh(None, "recorder/health missing", silent=True, age_s=9.0),
    }
    received = reached(arbiter=fresh(ArbiterStatus()), health=health)
    rows = {row["name"]: row for row in strip(CELL, received, "view")["services"]}
    assert rows["hub"] == {"name": "hub", "text": "250 Hz · 4 ms", "fault": ""}
    assert rows["sensor"]["fault"] == "the cable is out"
    assert rows["arbiter"]["fault"] == "arbiter/health stale"
    assert rows["regulator"]["fault"]
    assert "recorder" not in rows
    assert "recorder" not in now_text(received)
    health["recorder"] = fresh(Health(rate_hz=4.0), "recorder/health stale")
    assert strip(CELL, received, "view")["services"][-1]["fault"] == "recorder/health stale"
    assert "⚠ recorder: recorder/health stale" in now_text(received)


# --- force ----------------------------------------------------------------------------------------


@given(st.floats(-20.0, 40.0), st.floats(-10.0, 10.0), st.floats(0.0, 3.0))
def test_while_pressing_the_display_has_the_force_along_the_tool_and_its_set_point(
    press_N, side_N, angle_rad
):
    """In any attitude a side force does not count; without a press it is the norm of the force."""
    R = rotation_from_vector(np.array([angle_rad, 0.0, 0.0]))
    q = (float(np.sin(angle_rad / 2)), 0.0, 0.0, float(np.cos(angle_rad / 2)))
    force_N = vec3(-press_N * R[:, 2] + side_N * R[:, 0])
    received = reached(
        robot=fresh(RobotState(orientation_xyzw=q)),
        wrench=fresh(WrenchAtTcp(force_N=force_N, calibrated=True)),
        target=fresh(RegulatorTarget(mode="position", law="plain", setpoint_N=25.0)),
    )
    shown = force_display(CELL, received)
    assert (shown["caption"], shown["setpoint"], shown["lost"]) == ("normal force", "25.0", "")
    assert float(shown["value"]) == pytest.approx(press_N, abs=0.051)
    assert shown["value"] != "-0.0"
    for target in (
        RegulatorTarget(valid=False),
        RegulatorTarget(mode="orientation"),
        RegulatorTarget(mode="position", law="admittance"),
    ):
        other = force_display(CELL, replace(received, target=fresh(target)))
        assert (other["caption"], other["setpoint"]) == ("force |F|", "")
        assert float(other["value"]) == pytest.approx(np.hypot(press_N, side_N), abs=0.051)


@pytest.mark.parametrize(
    ("wrench", "hub_fault", "lost"),
    [
        (fresh(None, "wrench missing", silent=True), "", "no data"),
        (fresh(WrenchAtTcp(), "wrench stale", silent=True, age_s=2.31), "", "no data for 2.3 s"),
        (fresh(WrenchAtTcp(), "not finite"), "", "not valid"),
        (fresh(WrenchAtTcp()), "no hub", "no data"),
    ],
)
def test_without_a_fresh_wrench_the_display_has_no_number(wrench, hub_fault, lost):
    """Missing data is never shown as 0 N: there is no digit, but the reason."""
    shown = force_display(CELL, Snapshot(hub_fault=hub_fault, wrench=wrench))
    assert (shown["value"], shown["lost"]) == ("", lost)


SLOW = {"gain_share": 0.543, "round_trip_s": 0.0618, "modelled_round_trip_s": 0.0337}


@pytest.mark.parametrize(
    ("calibrated", "target", "note"),
    [
        (False, {}, ", not calibrated"),
        (True, {"mode": "position"}, ""),
        (True, {"gain_share": 0.5}, ", gains at 50 %"),
        (True, SLOW, ", gains at 54 %: loop delay 62 ms, model 34 ms"),
    ],
)
def test_a_missing_calibration_and_lowered_gains_are_shown(calibrated, target, note):
    """The number includes the weight of the tool; the gains follow the delay of the loop."""
    wrench = fresh(WrenchAtTcp(calibrated=calibrated))
    shown = force_display(CELL, reached(wrench=wrench, target=fresh(RegulatorTarget(**target))))
    assert shown["caption"] == f"force |F|{note}"


# --- Stop motion ----------------------------------------------------------------------------------

NO_ANSWER = f"{UNANSWERED} from the cell (text). Use the emergency stop"


@pytest.mark.parametrize(
    ("word", "state", "prefix"),
    [
        ("done", "ACTIVE", "text"),
        ("refused", "HOLDING", "refused: text"),
        ("no answer", "HOLDING", "the arm is held (state HOLDING); the reply was lost"),
        ("no answer", "FAULT", "the arm is held (state FAULT); the reply was lost"),
        ("no answer", "STOPPING", NO_ANSWER),
        ("no answer", "ACTIVE", NO_ANSWER),
        ("no answer", None, NO_ANSWER),
    ],
)
def test_a_stop_is_unanswered_only_where_the_state_does_not_confirm_it(word, state, prefix):
    """The state is checked before the message; an old or unknown state confirms nothing."""
    status = None if state is None else ArbiterStatus(state=state)
    shown = reached(arbiter=fresh(status, "" if status else "missing"))
    assert stop_text(RequestOutcome(word, "text"), shown).startswith(prefix)
    assert bool(held_as(shown)) is (state in ("HOLDING", "FAULT"))
    assert held_as(reached(arbiter=fresh(status, "arbiter/status stale"))) == ""

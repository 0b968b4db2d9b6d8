"""Status bar of the panel: force display, colours of the states, text of a trip."""

from itertools import combinations
from pathlib import Path
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
    RegulatorTarget,
    RobotState,
    WrenchAtTcp,
)
from services.panel.server import page
from services.panel.state_colours import NO_STATE, STATE_COLOURS, StateColour
from services.panel.status_bar import force_display, strip
from services.panel.watch import Snapshot
from tools.tree import ROOT

CELL = load_cell(Path(ROOT) / "cells" / "demo.yaml")
EVERY_COLOUR: dict[str, StateColour] = {"no state": NO_STATE, **dict(STATE_COLOURS.items())}
# Linear RGB for colour vision without one kind of cones: Machado et al., IEEE TVCG 15(6), 2009.
VISION = {
    "all cones": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
RGB_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
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
    """This matters most for ARMED and ACTIVE; the state's name is shown as well."""
    for one, other in combinations(EVERY_COLOUR, 2):
        colours = [
            lab(VISION[vision] @ linear(EVERY_COLOUR[name].background)) for name in (one, other)
        ]
        assert np.linalg.norm(colours[0] - colours[1]) > MIN_DISTANCE, (one, other)


def test_the_name_of_each_state_is_legible_on_its_colour():
    """The contrast is computed by WCAG."""
    for name, colour in EVERY_COLOUR.items():
        low, high = sorted(RGB_TO_XYZ[1] @ linear(each) for each in colour)
        assert (high + 0.05) / (low + 0.05) > MIN_CONTRAST, name


def test_the_page_and_the_bar_take_their_colours_from_the_table():
    """A state has its colours, an unknown one those of the page."""
    assert f"background: {NO_STATE.background}; color: {NO_STATE.text};" in page("a title")
    assert list(STATE_COLOURS) == list(get_args(ArbiterState))
    for state in get_args(ArbiterState):
        received = Snapshot(hub_fault="", arbiter=fresh(ArbiterStatus(state=state)))
        assert strip(CELL, received, "view")["colour"] == STATE_COLOURS[state]._asdict()
    assert strip(CELL, Snapshot(), "view")["colour"] == NO_STATE._asdict()


# --- force display --------------------------------------------------------------------------------


def fresh(message, fault="", *, silent=False, age_s=0.004):
    """Return a reading."""
    return Reading(message, None, age_s, fault, silent=silent)


def turned(angle_rad):
    """Return the state of a robot turned about x, and its rotation."""
    half = angle_rad / 2
    q = (float(np.sin(half)), 0.0, 0.0, float(np.cos(half)))
    return fresh(RobotState(orientation_xyzw=q)), rotation_from_vector(np.array([angle_rad, 0, 0]))


@given(st.floats(-20.0, 40.0), st.floats(-10.0, 10.0), st.floats(0.0, 3.0))
def test_while_pressing_the_display_has_the_force_along_the_tool_and_its_set_point(
    press_N, side_N, angle_rad
):
    """In any attitude a side force does not count; without a press it is the norm of the force."""
    robot, R = turned(angle_rad)
    force_N = vec3(-press_N * R[:, 2] + side_N * R[:, 0])
    received = Snapshot(
        hub_fault="",
        robot=robot,
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
        other = force_display(
            CELL, Snapshot(hub_fault="", robot=robot, wrench=received.wrench, target=fresh(target))
        )
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


def test_a_force_without_calibration_is_marked():
    """The number includes the weight of the tool."""
    received = Snapshot(hub_fault="", wrench=fresh(WrenchAtTcp(calibrated=False)))
    assert force_display(CELL, received)["caption"] == "force |F|, not calibrated"


@pytest.mark.parametrize(
    ("target", "note"),
    [
        (RegulatorTarget(mode="position"), ""),
        (RegulatorTarget(gain_share=0.5), ", gains at 50 %"),
        (
            RegulatorTarget(gain_share=0.543, round_trip_s=0.0618, modelled_round_trip_s=0.0337),
            ", gains at 54 %: loop delay 62 ms, model 34 ms",
        ),
    ],
)
def test_lowered_gains_are_shown_with_the_delay_of_the_loop(target, note):
    """At full gains nothing is added."""
    wrench = fresh(WrenchAtTcp(calibrated=True))
    shown = force_display(CELL, Snapshot(hub_fault="", wrench=wrench, target=fresh(target)))
    assert shown["caption"] == f"force |F|{note}"


# --- trips ----------------------------------------------------------------------------------------


def test_the_bar_shows_every_trip_with_its_limit_and_separately_its_remedy():
    """The reason is on the page itself, not only in a tooltip."""
    trips = (
        tripped("force", "force 31.2 N is above the ceiling", value=31.2, limit=30.0, unit="N"),
        tripped("hold", "the operator asked"),
    )
    status = ArbiterStatus(state="HOLDING", trips=trips, clears="clear, then arm")
    shown_bar = strip(CELL, Snapshot(hub_fault="", arbiter=fresh(status)), "operate")
    first = "force 31.2 N is above the ceiling (31.2 N, limit 30 N)"
    assert shown_bar["why"] == f"{first}; the operator asked"
    assert shown_bar["remedy"] == "clear, then arm"


@pytest.mark.parametrize(
    ("status", "who"),
    [
        (None, ""),
        (ArbiterStatus(), "commander: none"),
        (ArbiterStatus(commander="program"), "commander: program"),
        (
            ArbiterStatus(commander="regulator", next_commander="operator"),
            "commander: regulator, next: operator",
        ),
    ],
)
def test_the_bar_names_the_commander_and_the_next_one(status, who):
    """Nothing is shown while nothing is known."""
    received = Snapshot(hub_fault="", arbiter=fresh(status, "" if status else "missing"))
    assert strip(CELL, received, "view")["who"] == who


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
    received = Snapshot(hub_fault="", contact=fresh(event, fault))
    assert strip(CELL, received, "view")["contact"] == text

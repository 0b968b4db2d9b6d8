"""Status bar of the panel: state, cause, remedy, commander, force, and who may stop."""

from dataclasses import replace

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
    ArbiterStatus,
    AxisState,
    Health,
    RegulatorTarget,
    RobotState,
    WrenchAtTcp,
)
from services.panel.status_bar import force_display, strip
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


# Linear RGB for colour vision without one kind of cones: Machado et al., IEEE TVCG 15(6), 2009.
# fmt: off
# fmt: on
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


# --- force ----------------------------------------------------------------------------------------


COMPLIANT = AxisState(control="compliant", setpoint=0.0, exerted=0.0, deviation=0.0, at_limit=False)


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
        RegulatorTarget(mode="position", axes=(COMPLIANT,) * 6),
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


SLOW = RegulatorTarget(gain_share=0.543, round_trip_s=0.0618, modelled_round_trip_s=0.0337)


def test_a_missing_calibration_and_lowered_gains_are_shown():
    """The number includes the weight of the tool; the gains follow the delay of the loop."""
    for calibrated, target, note in (
        (False, RegulatorTarget(), ", not calibrated"),
        (True, RegulatorTarget(gain_share=0.5), ", gains at 50 %"),
        (True, SLOW, ", gains at 54 %: loop delay 62 ms, model 34 ms"),
    ):
        wrench = fresh(WrenchAtTcp(calibrated=calibrated))
        shown = force_display(CELL, reached(wrench=wrench, target=fresh(target)))
        assert shown["caption"] == f"force |F|{note}"


def test_the_bar_shows_each_service_with_its_rate_age_and_fault():
    """A cell without a recorder lacks nothing; one that has stopped is missing."""
    health = {
        "hub": fresh(Health(rate_hz=250.0)),
        "sensor": fresh(Health(rate_hz=500.0, fault="the cable is out")),
        "recorder": fresh(None, "recorder/health missing", silent=True, age_s=9.0),
    }
    rows = {row["name"]: row for row in strip(CELL, reached(health=health), "view")["services"]}
    assert rows["hub"] == {"name": "hub", "text": "250 Hz · 4 ms", "fault": ""}
    assert rows["sensor"]["fault"] == "the cable is out"
    assert rows["regulator"]["fault"]
    assert "recorder" not in rows
    health["recorder"] = fresh(Health(rate_hz=4.0), "recorder/health stale")
    last = strip(CELL, reached(health=health), "view")["services"][-1]
    assert last["fault"] == "recorder/health stale"

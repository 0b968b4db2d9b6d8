"""A wrong sign or axis is found where a person touches the arm, within 5 mm; what is right goes on.

The arm brakes within 1 mm of where the regulator gives up, so 4 mm are left to that.
"""

from itertools import permutations
from typing import Any

import numpy as np
import pytest

from common.motion.frames import Array
from forcemesh import topics
from forcemesh.requests import Empty, ForceStartRequest
from services.regulator.settings import law_settings
from services.regulator.unverified_axes import LIMIT_RAD, YieldTravel, trip_of
from tests.fakes.bench import CELL
from tests.fakes.long import long
from tests.fakes.regulator_bench import PERIOD_S
from tests.fakes.touched_plant import TouchedPlant

MOST_M = 0.004
MOST_OF_STIFF_M = 0.005  # the adaptive law on 1e4 N/m is fast, and the arm late
EYE = np.eye(3)
FLIPPED = [np.diag(signs) for signs in ((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1))]
SWAPPED = [EYE[list(order)] for order in permutations(range(3)) if list(order) != [0, 1, 2]]
WRONG = [*FLIPPED, *SWAPPED, EYE[[1, 0, 2]] @ FLIPPED[0]]
PRESSED_N = np.array([4.0, -3.0, 15.0])


def name(wiring: Array) -> str:
    """Return a wiring as the channels show it."""
    rows = (row.nonzero()[0][0] for row in wiring)
    return "".join(f"{'+' if wiring[i].sum() > 0 else '-'}{'xyz'[j]}" for i, j in enumerate(rows))


def travel(plant: TouchedPlant, seconds: float) -> float:
    """Return how far the tool goes along wrong axes until it is given up, or the time is over.

    Along an axis that is right it may leave what it presses on.
    """
    begin_m, most_m, wrong = plant.p_m, 0.0, np.diag(plant.wiring) != 1.0
    for _ in range(round(seconds / PERIOD_S)):
        plant.step()
        most_m = max(most_m, float(np.linalg.norm((plant.p_commanded_m - begin_m)[wrong])))
        if not plant.said().valid:
            break
    return most_m


# --- what is wrong --------------------------------------------------------------------------------


@pytest.mark.parametrize("stiffness_N_m", [2e3, long(1e4)])
@pytest.mark.parametrize("law", ["plain", long("adaptive")])
@pytest.mark.parametrize("wiring", WRONG, ids=name)
def test_in_contact_at_set_point_0_it_is_stopped_within_5_mm(
    wiring: Array, law: Any, stiffness_N_m: float
) -> None:
    """A contact that sticks, loaded along all axes."""
    plant = TouchedPlant(wiring)
    plant.touch(PRESSED_N, np.full(3, stiffness_N_m))
    assert plant.start(ForceStartRequest(mode="position", law=law)).accepted
    is_fast = law == "adaptive" and stiffness_N_m == 1e4
    assert travel(plant, 4.0) <= (MOST_OF_STIFF_M if is_fast else MOST_M)
    assert plant.said().code == "sensor_sign"


@pytest.mark.parametrize("wiring", WRONG, ids=name)
def test_on_a_plate_without_friction_a_force_that_does_not_fall_is_stopped(wiring: Array) -> None:
    """The press is shown beside the tool: it slides for ever, and the force is always there."""
    plant = TouchedPlant(wiring)
    plant.touch(np.array([0.0, 0.0, 15.0]), np.array([0.0, 0.0, 5e3]))
    assert plant.start(ForceStartRequest(mode="position")).accepted
    assert travel(plant, 4.0) <= MOST_M
    shows_z = wiring[2, 2] == 1.0
    assert plant.said().code == ("" if shows_z else "sensor_sign")


@pytest.mark.parametrize("wiring", WRONG, ids=name)
def test_started_in_contact_with_a_set_point_it_is_stopped_within_5_mm(wiring: Array) -> None:
    """The press along the tool may be right: then it is what lies beside it that runs away."""
    plant = TouchedPlant(wiring)
    plant.touch(PRESSED_N, np.full(3, 4e3))
    assert plant.start(ForceStartRequest(mode="position", setpoint_N=15.0)).accepted
    assert travel(plant, 4.0) <= MOST_M
    assert plant.said().code in {"sensor_sign", "travel"}


@pytest.mark.parametrize("wiring", WRONG, ids=name)
@pytest.mark.parametrize("pulled", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -1, 1)], ids=str)
def test_under_a_hand_at_set_point_0_it_is_stopped_within_5_mm(wiring: Array, pulled: Any) -> None:
    """A hand that takes the tool along: 20 mm in the first second, if it follows or not."""
    plant = TouchedPlant(wiring)
    assert plant.start(ForceStartRequest(mode="position")).accepted
    begin_m, most_m = plant.p_m, 0.0
    for number in range(round(2.0 / PERIOD_S)):
        drawn_m = min(0.02 * number * PERIOD_S, 0.02)
        plant.p_hand_m = begin_m + drawn_m * np.array(pulled) / np.linalg.norm(pulled)
        plant.step()
        most_m = max(most_m, float(np.linalg.norm(plant.p_commanded_m - begin_m)))
    is_shown = np.allclose(wiring @ np.array(pulled), pulled)
    assert most_m <= MOST_M
    assert is_shown or plant.said().code == "sensor_sign"


@pytest.mark.parametrize("stops", [False, True])
def test_a_new_set_point_is_no_new_budget(stops: bool) -> None:
    """Asked for again and again while it runs away, stopped in between or not."""
    plant = TouchedPlant(FLIPPED[0])
    plant.touch(PRESSED_N, np.full(3, 2e3))
    begin_m = plant.p_m
    for number in range(200):
        wanted = ForceStartRequest(mode="position", setpoint_N=10.0 + number % 2)
        assert plant.start(wanted).accepted
        plant.step(5)
        if not plant.said().valid:
            break
        if stops:
            assert plant.ask(topics.FORCE_STOP, Empty()).accepted
    assert plant.said().code == "sensor_sign"
    assert abs((plant.p_commanded_m - begin_m)[0]) <= MOST_M


def test_work_that_was_counted_lives_on_over_changes_of_set_point() -> None:
    """Begun free and pressing: what lies beside the tool creeps, 12 to 13 N and back."""
    plant = TouchedPlant(np.diag([-1.0, 1.0, 1.0]))
    assert plant.start(ForceStartRequest(mode="position", setpoint_N=12.0)).accepted
    plant.k_N_m = np.array([1e3, 1e3, 2e4])
    plant.p_rest_m = plant.p_m + np.array([0.002, 0.0, -0.0005])
    begin_m = plant.p_m
    for number in range(300):
        wanted = ForceStartRequest(mode="position", setpoint_N=12.0 + number % 2)
        assert plant.start(wanted).accepted
        plant.step(5)
        if not plant.said().valid:
            break
    assert plant.said().code == "sensor_sign"
    assert np.linalg.norm((plant.p_commanded_m - begin_m)[:2]) <= MOST_M


def test_hand_guiding_needs_the_proof() -> None:
    """Refused with the remedy, also in the place of what runs; accepted once axes were checked."""
    plant = TouchedPlant()
    wanted = ForceStartRequest(mode="position", law="admittance")
    reply = plant.start(wanted)
    assert (reply.accepted, reply.code) == (False, "axes_unproved")
    assert "check axes" in reply.text
    assert plant.start().accepted
    assert plant.start(wanted).code == "axes_unproved"
    plant.checked = True
    plant.step()
    assert plant.start(wanted).accepted


# --- what is right --------------------------------------------------------------------------------


@pytest.mark.parametrize("stiffness_N_m", [2e3, 2e4])
@pytest.mark.parametrize("law", ["plain", "adaptive"])
@pytest.mark.parametrize("axes_checked", [False, True])
def test_a_release_from_60_N_goes_on_to_its_end(
    law: Any, axes_checked: Any, stiffness_N_m: float
) -> None:
    """30 mm on a soft contact: the force falls all the way, which no wrong axis makes it do."""
    plant = TouchedPlant(axes_checked=axes_checked)
    plant.touch(np.array([0.0, 0.0, 60.0]), np.full(3, stiffness_N_m))
    assert plant.start(ForceStartRequest(mode="position", law=law)).accepted
    travel(plant, 8.0 if stiffness_N_m < 1e4 else 2.0)
    assert plant.said().valid
    assert plant.truth_N[2] < 2.0


@pytest.mark.parametrize("law", ["plain", "adaptive", "admittance"])
@pytest.mark.parametrize("pulled", [(1, 0, 0), (0, 0, 1), (1, -1, 1)], ids=str)
def test_a_hand_pulls_the_tool_200_mm(law: Any, pulled: Any) -> None:
    """Axes checked: it follows as long as the hand goes on."""
    plant = TouchedPlant(axes_checked=True)
    assert plant.start(ForceStartRequest(mode="position", law=law)).accepted
    begin_m, way = plant.p_m, np.array(pulled) / np.linalg.norm(pulled)
    speed_m_s = 0.5 * law_settings(CELL).speed_max_m_s
    for number in range(round(0.2 / speed_m_s / PERIOD_S)):
        plant.p_hand_m = begin_m + speed_m_s * number * PERIOD_S * way
        plant.step()
        assert plant.said().valid, plant.said().reason
    assert float((plant.p_m - begin_m) @ way) > 0.17


def test_a_touch_from_free_space_proves_the_axis_along_the_tool_and_no_other() -> None:
    """After it a hand may lead the tool up as far as it likes, but not sideways."""
    plant = TouchedPlant()
    assert plant.start(ForceStartRequest(mode="position", setpoint_N=10.0)).accepted
    plant.k_N_m = np.array([0.0, 0.0, 2e4])
    plant.p_rest_m = plant.p_m - np.array([0.0, 0.0, 0.001])
    plant.pass_s(1.5)
    assert plant.truth_N[2] == pytest.approx(10.0, abs=1.0)
    assert plant.start(ForceStartRequest(mode="position")).accepted
    for way, is_proved in (((0.0, 0.0, 1.0), True), ((0.0, 1.0, 0.0), False)):
        begin_m = plant.p_m
        for number in range(round(4.0 / PERIOD_S)):
            plant.p_hand_m = begin_m + 0.01 * number * PERIOD_S * np.array(way)
            plant.step()
        assert plant.said().valid == is_proved
        assert (np.linalg.norm(plant.p_m - begin_m) > 0.02) == is_proved


def test_a_tool_that_turns_to_a_torque_is_stopped_at_its_limit() -> None:
    """Only where it may turn, and only while an axis is unproved; the trip has both numbers."""
    free_N, unproved = np.zeros(3), np.array([True, True, False])
    at, beyond = YieldTravel(turn_rad=LIMIT_RAD), YieldTravel(turn_rad=LIMIT_RAD + 1e-9)
    assert trip_of(at, free_N, unproved, turns=True) is None
    assert trip_of(beyond, free_N, unproved, turns=False) is None
    assert trip_of(beyond, free_N, np.zeros(3, dtype=bool), turns=True) is None
    trip = trip_of(beyond, free_N, unproved, turns=True)
    assert trip is not None
    assert (trip.code, trip.value, trip.limit) == ("sensor_sign", LIMIT_RAD + 1e-9, LIMIT_RAD)
    assert "forcemesh check axes" in trip.text

"""A wrong sign or axis stops the arm within 5 mm of travel against a hand or contact.

The arm brakes within 1 mm after the regulator has stopped, so 4 mm are left for detection.
Correct axes continue.
"""

from itertools import permutations
from typing import Any

import numpy as np
import pytest

from common.motion.frames import Array
from control.law import LawSettings
from control.unverified_axes import LIMIT_RAD, YieldTravel
from forcemesh import topics
from forcemesh.messages import ZERO3
from forcemesh.requests import Empty, ForceStartRequest
from tests.fakes.bench import CELL
from tests.fakes.long import long
from tests.fakes.regulator_bench import PERIOD_S
from tests.fakes.touched_plant import TouchedPlant

MAX_TRAVEL_M = 0.004
MAX_TRAVEL_STIFF_M = 0.005  # the adaptive law on 1e4 N/m is fast, and the arm delayed
EYE = np.eye(3)
FLIPPED = [np.diag(signs) for signs in ((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1))]
SWAPPED = [EYE[list(order)] for order in permutations(range(3)) if list(order) != [0, 1, 2]]
WRONG = [*FLIPPED, *SWAPPED, EYE[[1, 0, 2]] @ FLIPPED[0]]
PRESSED_N = np.array([4.0, -3.0, 15.0])


def name_of(axis_map: Array) -> str:
    """Return an axis map as the channels show it."""
    rows = (row.nonzero()[0][0] for row in axis_map)
    return "".join(f"{'+' if axis_map[i].sum() > 0 else '-'}{'xyz'[j]}" for i, j in enumerate(rows))


def travel(plant: TouchedPlant, seconds: float) -> float:
    """Return the tool's travel along wrong axes until the regulator stops or the time is over.

    Along a correct axis the tool may leave the contact.
    """
    begin_m, furthest_m, wrong = plant.p_m, 0.0, np.diag(plant.wiring) != 1.0
    for _ in range(round(seconds / PERIOD_S)):
        plant.step()
        furthest_m = max(furthest_m, float(np.linalg.norm((plant.p_commanded_m - begin_m)[wrong])))
        if not plant.published().valid:
            break
    return furthest_m


@pytest.mark.parametrize("stiffness_N_m", [2e3, long(1e4)])
@pytest.mark.parametrize("law", ["plain", long("adaptive")])
@pytest.mark.parametrize("axis_map", WRONG, ids=name_of)
def test_in_contact_at_set_point_0_it_is_stopped_within_5_mm(axis_map, law, stiffness_N_m) -> None:
    """The contact has friction and is loaded along all axes."""
    plant = TouchedPlant(axis_map)
    plant.touch(PRESSED_N, np.full(3, stiffness_N_m))
    assert plant.start(ForceStartRequest(mode="position", law=law)).accepted
    is_fast = law == "adaptive" and stiffness_N_m == 1e4
    assert travel(plant, 4.0) <= (MAX_TRAVEL_STIFF_M if is_fast else MAX_TRAVEL_M)
    assert plant.published().code == "sensor_sign"


@pytest.mark.parametrize("axis_map", WRONG, ids=name_of)
@pytest.mark.parametrize("pull", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -1, 1)], ids=str)
def test_under_a_hand_at_set_point_0_it_is_stopped_within_5_mm(axis_map: Array, pull: Any) -> None:
    """A hand pulls the tool 20 mm in the first second, if it follows or not."""
    plant = TouchedPlant(axis_map)
    assert plant.start(ForceStartRequest(mode="position")).accepted
    begin_m, furthest_m = plant.p_m, 0.0
    for number in range(round(2.0 / PERIOD_S)):
        drawn_m = min(0.02 * number * PERIOD_S, 0.02)
        plant.p_hand_m = begin_m + drawn_m * np.array(pull) / np.linalg.norm(pull)
        plant.step()
        furthest_m = max(furthest_m, float(np.linalg.norm(plant.p_commanded_m - begin_m)))
    is_shown = np.allclose(axis_map @ np.array(pull), pull)
    assert furthest_m <= MAX_TRAVEL_M
    assert is_shown or plant.published().code == "sensor_sign"


@pytest.mark.parametrize("stops", [False, True])
def test_a_new_set_point_gives_no_new_budget(stops: bool) -> None:
    """Requested again and again while it runs away, with or without a stop in between."""
    plant = TouchedPlant(FLIPPED[0])
    plant.touch(PRESSED_N, np.full(3, 2e3))
    begin_m = plant.p_m
    for number in range(200):
        request = ForceStartRequest(mode="position", setpoint_N=10.0 + number % 2)
        assert plant.start(request).accepted
        plant.step(5)
        if not plant.published().valid:
            break
        if stops:
            assert plant.ask(topics.FORCE_STOP, Empty()).accepted
    assert plant.published().code == "sensor_sign"
    assert abs((plant.p_commanded_m - begin_m)[0]) <= MAX_TRAVEL_M


@pytest.mark.parametrize("stiffness_N_m", [2e3, 2e4])
@pytest.mark.parametrize("law", ["plain", "adaptive"])
@pytest.mark.parametrize("axes_checked", [False, True])
def test_a_release_from_60_N_continues_to_its_end(law, axes_checked, stiffness_N_m) -> None:
    """30 mm on a soft contact: the force falls throughout, which no wrong axis does."""
    plant = TouchedPlant(axes_checked=axes_checked)
    plant.touch(np.array([0.0, 0.0, 60.0]), np.full(3, stiffness_N_m))
    assert plant.start(ForceStartRequest(mode="position", law=law)).accepted
    travel(plant, 8.0 if stiffness_N_m < 1e4 else 2.0)
    assert plant.published().valid
    assert plant.truth_N[2] < 2.0


@pytest.mark.parametrize("law", ["plain", "adaptive", "admittance"])
@pytest.mark.parametrize("pull", [(1, 0, 0), (0, 0, 1), (1, -1, 1)], ids=str)
def test_a_hand_pulls_the_tool_200_mm(law: Any, pull: Any) -> None:
    """With checked axes the tool follows as long as the hand moves."""
    plant = TouchedPlant(axes_checked=True)
    assert plant.start(ForceStartRequest(mode="position", law=law)).accepted
    begin_m, direction = plant.p_m, np.array(pull) / np.linalg.norm(pull)
    speed_m_s = 0.5 * LawSettings.of(CELL).speed_max_m_s
    for number in range(round(0.2 / speed_m_s / PERIOD_S)):
        plant.p_hand_m = begin_m + speed_m_s * number * PERIOD_S * direction
        plant.step()
        assert plant.published().valid, plant.published().reason
    assert float((plant.p_m - begin_m) @ direction) > 0.17


@pytest.mark.parametrize(
    ("mode", "calibration", "direction", "is_verified"),
    [
        ("position", "cell file, tared", (0.0, 0.0, 1.0), True),
        ("position", "cell file", (0.0, 0.0, 1.0), True),
        ("position", "another", (0.0, 0.0, 1.0), False),
        ("both", "cell file, tared", (0.0, 0.0, 1.0), False),
        ("position", "cell file, tared", (0.0, 1.0, 0.0), False),
    ],
)
def test_a_touch_from_free_space_verifies_the_tools_axis_only(
    mode: Any, calibration: str, direction: Any, is_verified: bool
) -> None:
    """A hand may then guide it up without limit: for that calibration, unless the tool may turn."""
    plant = TouchedPlant()
    assert plant.start(ForceStartRequest(mode="position", setpoint_N=10.0)).accepted
    plant.k_N_m = np.array([0.0, 0.0, 2e4])
    plant.p_rest_m = plant.p_m - np.array([0.0, 0.0, 0.001])
    plant.pass_s(1.5)
    assert plant.truth_N[2] == pytest.approx(10.0, abs=1.0)
    assert plant.ask(topics.FORCE_STOP, Empty()).accepted
    plant.calibration = calibration
    plant.step()
    assert plant.start(ForceStartRequest(mode=mode)).accepted
    begin_m = plant.p_m
    for number in range(round(4.0 / PERIOD_S)):
        plant.p_hand_m = begin_m + 0.01 * number * PERIOD_S * np.array(direction)
        plant.step()
    assert plant.published().valid == is_verified
    assert (np.linalg.norm(plant.p_m - begin_m) > 0.02) == is_verified


def test_a_tool_that_turns_by_a_torque_is_stopped_at_its_limit() -> None:
    """Only with free rotation and an unverified axis; the trip has both numbers."""
    free_N, unproved = ZERO3, (True, True, False)
    at, beyond = YieldTravel(turn_rad=LIMIT_RAD), YieldTravel(turn_rad=LIMIT_RAD + 1e-9)
    assert at.trip(free_N, unproved, rotates=True) is None
    assert beyond.trip(free_N, unproved, rotates=False) is None
    assert beyond.trip(free_N, (False,) * 3, rotates=True) is None
    trip = beyond.trip(free_N, unproved, rotates=True)
    assert trip is not None
    assert (trip.code, trip.value, trip.limit) == ("sensor_sign", LIMIT_RAD + 1e-9, LIMIT_RAD)
    assert "forcemesh check axes" in trip.text

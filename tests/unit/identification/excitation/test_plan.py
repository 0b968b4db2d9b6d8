"""Plan of a calibration: paths inside the workspace, well conditioned, reproducible."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.calibration import by_arm
from common.config.load import load_cell
from common.motion.convert import record_of
from common.motion.kinematics import ArmKinematics
from forcemesh.messages import RobotState
from identification.errors import CalibrationError
from identification.excitation.plan import (
    LEAST_PLANNED_POSES,
    CalibrationPlan,
    PlanOptions,
    make_plan,
)
from identification.static_poses import angle
from tests.fakes.arms import unknown_arm
from tests.fakes.bench import DEMO
from tests.fakes.calibration import HOME_RAD

ARM = ArmKinematics("rs007l")
SPREAD_RAD = np.radians([40.0, 15.0, 15.0, 20.0, 20.0, 60.0])  # of start poses, about the demo's
WALL = {"point_m": [0.0, 0.62, 0.0], "normal": [0.0, -2.0, 0.0]}


def cell_with(**overrides):
    """Return the demo's cell, uncalibrated, with some limits changed."""
    changes = {f"limits.{name}": value for name, value in overrides.items()}
    return load_cell(DEMO, changes)


def stops_of(plan: CalibrationPlan) -> list[np.ndarray]:
    """Return every joint goal of a plan, from the start back to the start."""
    route = plan.route
    stops = [route.q_start, *route.goals_to_hub(route.q_start)]
    for place in (*plan.fit, *plan.verify):
        stops += route.goals(stops[-1], plan.q[place])
    return [*stops, route.hub, *route.goals_to_start(route.hub)]


def points_of(cell, q):
    """Return flange, sensor and TCP in base, worked out from the frames of the cell file."""
    T = ARM.flange_pose(q)
    frames = (T, T * cell.sensor.T_flange_sensor.pose, T * cell.tool.T_flange_tcp.pose)
    return np.array([frame.translation for frame in frames])


def assert_inside(cell, plan: CalibrationPlan) -> None:
    """Check every point of the whole path in small steps."""
    lowest_m = points_of(cell, plan.route.q_start)[:, 2].min() - 1e-6
    low, high = np.array(cell.limits.workspace_min_m), np.array(cell.limits.workspace_max_m)
    joint_low, joint_high = (
        np.radians(limit) for limit in (cell.robot.joint_min_deg, cell.robot.joint_max_deg)
    )
    for q_from, q_to in pairwise(stops_of(plan)):
        count = 1 + int(np.abs(q_to - q_from).max() / np.radians(0.7))
        for share in np.linspace(0.0, 1.0, count + 1):
            q = q_from + share * (q_to - q_from)
            points = points_of(cell, q)
            assert (points >= low).all()
            assert (points <= high).all()
            assert points[:, 2].min() >= lowest_m
            assert (q > joint_low).all()
            assert (q < joint_high).all()
            for plane in cell.limits.planes:
                assert ((points - plane.point_m) @ np.array(plane.normal)).min() >= 0.0


def plan_or_refusal(cell, q_start, options) -> CalibrationPlan | str:
    """Return the plan, or the sentence that refuses it."""
    try:
        return make_plan(cell, ARM, q_start, options)
    except CalibrationError as error:
        return str(error)


@settings(max_examples=6, deadline=None)
@given(
    offset=st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6),
    walls=st.sampled_from([[], [WALL]]),
    turn_deg=st.sampled_from([60.0, 120.0, 180.0]),
)
def test_goals_and_paths_stay_inside_from_any_start(offset, walls, turn_deg):
    """Three points keep box, walls, floor and joint limits, or the plan is refused with advice."""
    cell = cell_with(planes=walls)
    q_start = HOME_RAD + np.array(offset) * SPREAD_RAD
    found = plan_or_refusal(cell, q_start, PlanOptions(turn_rad=np.radians(turn_deg)))
    if isinstance(found, str):
        assert "--manual" in found
        return
    assert_inside(cell, found)
    assert found.conditioning <= 30.0


@pytest.fixture(scope="module")
def plan() -> CalibrationPlan:
    """The plan of the demo's cell."""
    return make_plan(cell_with(), ARM, HOME_RAD, PlanOptions())


def test_fresh_poses_are_far_from_those_of_the_fit(plan):
    """Poses that verify differ from those of the fit by tens of degrees."""
    fit = plan.R_base_sensor[list(plan.fit)]
    apart = [angle(plan.R_base_sensor[place], fit).min() for place in plan.verify]
    assert len(apart) == 4
    assert min(apart) > np.radians(20.0)
    assert not set(plan.fit) & set(plan.verify)


def test_a_refused_pose_is_replaced_by_another_one(plan):
    """The plan keeps its size; neither the refused pose nor one close to it is chosen again."""
    refused = plan.fit[3]
    other = plan.without(refused)
    assert len(other.fit) == len(plan.fit)
    assert refused not in (*other.fit, *other.verify)
    new = set(other.fit) - set(plan.fit)
    apart = angle(plan.R_base_sensor[refused], plan.R_base_sensor[list(new)])
    assert apart.min() > np.radians(15.0)
    fewer = plan.without(plan.verify[0])
    assert len(fewer.verify) == len(plan.verify)
    assert fewer.fit == plan.fit


def test_refusing_every_pose_ends_with_advice(plan):
    """There is no endless search: below six poses the error gives the remedy."""
    ended = r"only 5 poses remain, at least 6 are needed: .*--manual"
    with pytest.raises(CalibrationError, match=ended):  # noqa: PT012 - in one of many refusals
        for _ in range(len(plan.q)):
            plan = plan.without(plan.fit[0])


@pytest.mark.parametrize(
    ("limits", "problem"),
    [
        ({"workspace_min_m": [-0.4, 0.2, 0.3]}, "TCP would be at z = 217 mm"),
        ({"workspace_max_m": [0.4, 0.8, 0.38]}, "no room to rotate the tool"),
        (
            {"workspace_min_m": [-0.05, 0.425, 0.2], "workspace_max_m": [0.05, 0.525, 0.5]},
            f"poses are possible inside the box, at least {LEAST_PLANNED_POSES} are needed",
        ),
        ({"planes": [{"point_m": [0, 0.4, 0], "normal": [0, -1, 0]}]}, "behind or near plane 1"),
        ({"tether_m": 0.011}, "tether"),
    ],
)
def test_a_cell_without_room_is_refused_with_advice(limits, problem):
    """One sentence gives the cause and the remedy."""
    with pytest.raises(CalibrationError, match=problem) as error:
        make_plan(cell_with(**limits), ARM, HOME_RAD, PlanOptions())
    assert "--manual" in str(error.value)


def test_an_arm_without_a_model_or_at_another_pose_than_the_model_is_refused() -> None:
    """With TOOL set on the pendant, a plan by the model would lead to other poses."""
    cell, T_flange = cell_with(), ARM.flange_pose(HOME_RAD)
    for of, T, problem in (
        (cell, T_flange * cell.tool.T_flange_tcp.pose, "does not agree .*TOOL is the cell file"),
        (unknown_arm(), T_flange, r"robot\.model is unknown"),
    ):
        record = record_of(T)
        state = RobotState(
            position_m=record.position_m,
            orientation_xyzw=record.orientation_xyzw,
            joint_rad=tuple(HOME_RAD.tolist()),
        )
        with pytest.raises(CalibrationError, match=f"{problem}.*--manual"):
            by_arm._model(of, state)

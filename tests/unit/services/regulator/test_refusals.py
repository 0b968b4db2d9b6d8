"""Refusals of a start or a path: the reason, and no change of the present operation."""

from typing import Any

import numpy as np
import pytest

from forcemesh import topics
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import ForceStartRequest, PathRequest
from services.regulator.tcp_path import MOST_PATH_POINTS
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import (
    POSITION,
    T_FLANGE_TCP,
    RegulatorBench,
    assert_stopped,
)

TWO_HOSTS = CELL.robot.model_copy(update={"hosts": ("pc", "controller")})
START_M = (T_START * T_FLANGE_TCP).translation
LIMIT_X_M = CELL.limits.workspace_max_m[0]


@pytest.fixture
def bench() -> RegulatorBench:
    """Return an armed cell whose controller supports force feedback; nothing is started."""
    bench = RegulatorBench(CELL.model_copy(update={"robot": TWO_HOSTS}))
    bench.pass_s(0.1)
    return bench


def near_tool(x_m: float, z_m: float = 0.0) -> tuple[float, float, float]:
    """Return a point at an offset from the tool."""
    x, y, z = START_M + np.array([x_m, 0.0, z_m])
    return float(x), float(y), float(z)


# --- a start --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "code", "prefix"),
    [
        ({"law": "admittance"}, "host", "law admittance"),
        ({"axes": (True, True, True, True, True, False)}, "host", "axes"),
    ],
)
def test_options_of_the_pc_are_refused_on_the_controller(
    bench: RegulatorBench, changes: dict[str, Any], code: str, prefix: str
) -> None:
    """The controller would run something else than requested; on the PC the same is accepted."""
    request = {"mode": "position", "host": "controller"} | changes
    reply = bench.start(ForceStartRequest.from_dict(request))
    assert (reply.accepted, reply.code) == (False, code)
    assert reply.text.startswith(prefix)
    bench.step()
    assert_stopped(bench, "stopped")
    assert bench.start(ForceStartRequest.from_dict(request | {"host": "pc"})).accepted


def test_hand_guiding_is_accepted_at_set_point_0_only(bench: RegulatorBench) -> None:
    """A hand and a set point are two targets for one axis."""
    request = ForceStartRequest(mode="position", law="admittance", setpoint_N=1.0)
    reply = bench.start(request)
    assert (reply.accepted, reply.code, reply.value, reply.limit) == (False, "setpoint", 1.0, 0.0)
    assert bench.start(request.replaced(setpoint_N=0.0)).accepted


@pytest.mark.parametrize(("armed_for", "purpose"), [("jog", "jog"), ("back_off", "backing off")])
def test_an_arm_armed_for_a_lesser_purpose_starts_no_force_feedback(
    bench: RegulatorBench, armed_for: Any, purpose: str
) -> None:
    """Arming for a jog has checked nothing that force feedback needs."""
    bench.arbiter = ArbiterStatus(state="ARMED", lease=3, armed_for=armed_for)
    bench.step()
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, "not_armed")
    assert reply.text == f"armed for {purpose} alone: hold, then arm for all"


def test_without_an_arbiter_nothing_starts(bench: RegulatorBench) -> None:
    """No arbiter would stop the arm."""
    bench.silent = {topics.ARBITER_STATUS.key}
    bench.pass_s(CELL.stale_after_s(topics.ARBITER_STATUS) + 0.1)
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, "not_armed")
    assert "the arbiter is silent" in reply.text


@pytest.mark.parametrize("checked", [True, False])
def test_hand_guiding_requires_checked_axes(bench: RegulatorBench, checked: bool) -> None:
    """A wrong sign looks like a hand; the refusal names the calibration and the check."""
    bench.wrench = bench.wrench.replaced(axes_checked=checked)
    bench.step()
    reply = bench.start(ForceStartRequest(mode="position", law="admittance"))
    assert reply.accepted == checked
    assert checked or (reply.code, "forcemesh check axes" in reply.text) == ("axes_unproved", True)


# --- a path ---------------------------------------------------------------------------------------


def test_the_controller_follows_no_path(bench: RegulatorBench) -> None:
    """It moves the arm by itself; on the PC the same points are accepted."""
    points = PathRequest(points_m=(near_tool(0.01),))
    for host, accepted in (("controller", False), ("pc", True)):
        request = ForceStartRequest.from_dict({"mode": "both", "host": host})
        assert bench.start(request).accepted
        reply = bench.ask(topics.FORCE_PATH, points)
        assert (reply.accepted, reply.code) == (accepted, "ok" if accepted else "host")


def test_points_are_refused_after_the_regulator_stopped(bench: RegulatorBench) -> None:
    """A latched failure follows no path."""
    assert bench.start(POSITION).accepted
    bench.silent = {topics.WRENCH.key}
    bench.pass_s(0.2)
    assert not bench.published().valid
    reply = bench.ask(topics.FORCE_PATH, PathRequest(points_m=(near_tool(0.01),)))
    assert (reply.accepted, reply.code) == (False, "not_armed")


def test_the_number_of_pending_points_is_limited(bench: RegulatorBench) -> None:
    """The last one fits, the next one is refused with both numbers; a replacement is accepted."""
    bench.start(POSITION)
    batch, limit = 50, MOST_PATH_POINTS
    path = tuple(near_tool(1e-4 * number) for number in range(1, batch + 1))
    for _ in range(limit // batch):
        assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=path, append=True)).accepted
    more = PathRequest(points_m=path[-1:], append=True)
    reply = bench.ask(topics.FORCE_PATH, more)
    assert (reply.accepted, reply.code) == (False, "busy")
    assert (reply.value, reply.limit) == (limit + 1, limit)
    assert bench.ask(topics.FORCE_PATH, more.replaced(append=False)).accepted


def test_a_point_outside_the_workspace_is_reported_with_its_number(bench: RegulatorBench) -> None:
    """Only the position across the tool's axis is checked; the force decides along it."""
    bench.start(POSITION)
    deep = near_tool(0.01, z_m=-5.0)
    assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=(deep,))).accepted
    outside = (LIMIT_X_M + 1e-3, float(START_M[1]), float(START_M[2]))
    reply = bench.ask(topics.FORCE_PATH, PathRequest(points_m=(deep, outside)))
    assert (reply.accepted, reply.code) == (False, "workspace")
    assert reply.text.startswith("point 2: ")

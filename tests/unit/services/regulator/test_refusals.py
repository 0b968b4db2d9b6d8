"""Why the regulator refuses a start or a path; after a refusal it does what it did before."""

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
    """An armed cell with a controller that could run force feedback; nothing is started."""
    bench = RegulatorBench(CELL.model_copy(update={"robot": TWO_HOSTS}))
    bench.pass_s(0.1)
    return bench


def beside(x_m: float, z_m: float = 0.0) -> tuple[float, float, float]:
    """Return a place beside the tool."""
    x, y, z = START_M + np.array([x_m, 0.0, z_m])
    return float(x), float(y), float(z)


# --- a start --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"law": "admittance"}, "host", "law admittance"),
        ({"axes": (True, True, True, True, True, False)}, "host", "axes"),
    ],
)
def test_what_only_the_pc_can_do_is_refused_on_the_controller(
    bench: RegulatorBench, changes: dict[str, Any], code: str, words: str
) -> None:
    """It would run something else than what was asked for; on the PC the same is accepted."""
    wanted = {"mode": "position", "host": "controller"} | changes
    reply = bench.start(ForceStartRequest.model_validate(wanted))
    assert (reply.accepted, reply.code) == (False, code)
    assert reply.text.startswith(words)
    bench.step()
    assert_stopped(bench, "stopped")
    assert bench.start(ForceStartRequest.model_validate(wanted | {"host": "pc"})).accepted


def test_a_hand_is_given_way_to_at_set_point_0_alone(bench: RegulatorBench) -> None:
    """A hand that leads and a press that is kept are two wishes for one axis."""
    wanted = ForceStartRequest(mode="position", law="admittance", setpoint_N=1.0)
    reply = bench.start(wanted)
    assert (reply.accepted, reply.code, reply.value, reply.limit) == (False, "setpoint", 1.0, 0.0)
    assert bench.start(wanted.model_copy(update={"setpoint_N": 0.0})).accepted


@pytest.mark.parametrize(("armed_for", "what"), [("jog", "jog"), ("back_off", "backing off")])
def test_an_arm_that_is_armed_for_less_starts_no_force_feedback(
    bench: RegulatorBench, armed_for: Any, what: str
) -> None:
    """Its checks were those of a jog: nobody has looked at what force feedback needs."""
    bench.arbiter = ArbiterStatus(state="ARMED", lease=3, armed_for=armed_for)
    bench.step()
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, "not_armed")
    assert reply.text == f"armed for {what} alone: hold, then arm for all"


def test_without_an_arbiter_nothing_starts(bench: RegulatorBench) -> None:
    """Nobody would stop the arm."""
    bench.silent = {topics.ARBITER_STATUS.key}
    bench.pass_s(CELL.stale_after_s(topics.ARBITER_STATUS) + 0.1)
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, "not_armed")
    assert "the arbiter is silent" in reply.text


@pytest.mark.parametrize("checked", [True, False])
def test_a_hand_guides_only_with_axes_that_were_checked(
    bench: RegulatorBench, checked: bool
) -> None:
    """A wrong sign looks like a hand; the refusal names the calibration and the check."""
    bench.wrench = bench.wrench.model_copy(update={"axes_checked": checked})
    bench.step()
    reply = bench.start(ForceStartRequest(mode="position", law="admittance"))
    assert reply.accepted == checked
    assert checked or (reply.code, "forcemesh check axes" in reply.text) == ("axes_unproved", True)


# --- a path ---------------------------------------------------------------------------------------


def test_the_controller_follows_no_points(bench: RegulatorBench) -> None:
    """It moves the arm by itself; on the PC the same points are taken."""
    points = PathRequest(points_m=(beside(0.01),))
    for host, accepted in (("controller", False), ("pc", True)):
        wanted = ForceStartRequest.model_validate({"mode": "both", "host": host})
        assert bench.start(wanted).accepted
        reply = bench.ask(topics.FORCE_PATH, points)
        assert (reply.accepted, reply.code) == (accepted, "ok" if accepted else "host")


def test_points_are_refused_after_the_regulator_gave_up(bench: RegulatorBench) -> None:
    """It runs in name only: nothing would go along them."""
    assert bench.start(POSITION).accepted
    bench.silent = {topics.WRENCH.key}
    bench.pass_s(0.2)
    assert not bench.said().valid
    reply = bench.ask(topics.FORCE_PATH, PathRequest(points_m=(beside(0.01),)))
    assert (reply.accepted, reply.code) == (False, "not_armed")


def test_no_more_points_wait_than_there_is_room_for(bench: RegulatorBench) -> None:
    """The last one fits, the next one is refused with both numbers; points instead are taken."""
    bench.start(POSITION)
    batch, most = 50, MOST_PATH_POINTS
    way = tuple(beside(1e-4 * number) for number in range(1, batch + 1))
    for _ in range(most // batch):
        assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=way, append=True)).accepted
    more = PathRequest(points_m=way[-1:], append=True)
    reply = bench.ask(topics.FORCE_PATH, more)
    assert (reply.accepted, reply.code) == (False, "busy")
    assert (reply.value, reply.limit) == (most + 1, most)
    assert bench.ask(topics.FORCE_PATH, more.model_copy(update={"append": False})).accepted


def test_a_point_outside_the_workspace_is_named_with_its_number(bench: RegulatorBench) -> None:
    """Across the tool's axis the wall binds; along it the force has the say, so no point does."""
    bench.start(POSITION)
    deep = beside(0.01, z_m=-5.0)
    assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=(deep,))).accepted
    outside = (LIMIT_X_M + 1e-3, float(START_M[1]), float(START_M[2]))
    reply = bench.ask(topics.FORCE_PATH, PathRequest(points_m=(deep, outside)))
    assert (reply.accepted, reply.code) == (False, "workspace")
    assert reply.text.startswith("point 2: ")

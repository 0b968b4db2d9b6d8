"""The lag of a link: late commands freeze the law, commands in time never do."""

from copy import deepcopy
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.config.load import load_cell
from common.motion.convert import record_of
from control.timing import LoopTiming, TimingSettings
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.messages import UNIT_QUATERNION, ZERO3, PoseRecord
from forcemesh.requests import ForceStartRequest, PathRequest
from launch import virtual_cell as virtual
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL, DEMO
from tests.fakes.lab import Lab
from tests.fakes.long import long
from tests.fakes.regulator_bench import PERIOD_S, T_FLANGE_TCP, RegulatorBench
from tests.fakes.stalling_wire import StallingWire

WINDOW = int(TimingSettings.of(CELL).window_s / PERIOD_S)  # commands kept in addition to the newest


def test_an_unsent_command_beyond_the_window_lags_until_it_is_sent() -> None:
    """Only the first pose of a steady motion was sent; after the rest was sent nothing lags."""
    first = command = PoseRecord(position_m=ZERO3, orientation_xyzw=UNIT_QUATERNION)
    commanded = LoopTiming(TimingSettings.of(CELL), 0)
    assert not commanded.lags(command, PERIOD_S, command)
    for number in range(1, 3 * WINDOW):
        command = command.replaced(position_m=(0.0, 0.0, 1e-4 * number))
        assert commanded.lags(command, PERIOD_S, first) == (number > WINDOW)
        if number > WINDOW:  # a restart keeps the unsent commands
            again = deepcopy(commanded)
            oldest = again.restart()
            assert oldest == commanded.commands[0][1]
            assert deepcopy(again).lags(command, PERIOD_S, first)
            assert not deepcopy(again).lags(oldest, PERIOD_S, oldest)
            assert again.restart() == oldest
    assert not commanded.lags(command, PERIOD_S, command)


def test_a_path_waits_for_a_lagging_link() -> None:
    """The set point never goes back, the rest of the path stays, and then it continues."""
    bench = RegulatorBench()
    bench.push((0.0, 0.0, 5.0))
    bench.pass_s(0.1)
    assert bench.start(ForceStartRequest(mode="position", setpoint_N=5.0)).accepted
    x, y, z = bench.T_base_tcp().translation
    path = PathRequest(points_m=((x + 0.05, y, z),), speed_m_s=0.04)
    assert bench.ask(topics.FORCE_PATH, path).accepted
    bench.pass_s(0.1)
    stuck = bench.published().pose
    bench.robot = bench.robot.replaced(sent=stuck)
    begun_m, furthest_m = bench.T_base_tcp().translation[0], 0.0
    for _ in range(WINDOW + 3):
        bench.step()
        furthest_m = max(furthest_m, float(bench.T_base_tcp().translation[0]))
    stood, left_m = bench.T_base_tcp().translation, bench.published().path_left_m
    assert stood[0] == furthest_m > begun_m
    bench.pass_s(0.5)
    assert np.array_equal(bench.T_base_tcp().translation, stood)
    assert bench.published().path_left_m == left_m
    assert left_m is not None
    bench.robot = bench.robot.replaced(sent=bench.published().pose)
    bench.pass_s(3 * PERIOD_S)
    assert bench.T_base_tcp().translation[0] > stood[0]


@pytest.mark.parametrize("law", ["plain", "adaptive"])
def test_a_link_that_lags_from_the_first_sample_moves_nothing_and_is_no_error(law: Any) -> None:
    """The robot reports a pose of an earlier session: the law has no output yet and waits."""
    bench = RegulatorBench()
    bench.push((0.0, 0.0, 5.0))
    bench.pass_s(0.1)
    elsewhere = pin.SE3(T_START.rotation, T_START.translation + np.array([0.0, 0.0, 0.01]))
    bench.robot = bench.robot.replaced(sent=record_of(elsewhere))
    bench.step()
    assert bench.start(ForceStartRequest(mode="position", law=law)).accepted
    for _ in range(100):
        bench.step()
        assert bench.published().valid
        assert bench.published().error_force_N == (0.0, 0.0, 0.0)
    start_m = (T_START * T_FLANGE_TCP).translation
    assert np.allclose(bench.T_base_tcp().translation, start_m, atol=1e-12)


TCP_CELL = load_cell(DEMO.with_name("demo-tcp.yaml"), {"sim.gap_m": 0.002})
SETPOINT_N = 20.0
MAX_N = 1.3 * SETPOINT_N
MIN_N = 1.0  # contact force of a tool that has not lifted off


@pytest.mark.parametrize("stall_ms", [long(50), long(120), 200, long(240)])
@pytest.mark.parametrize("direction", ["out", "in"])
@pytest.mark.parametrize(
    ("host", "law"), [("pc", "plain"), ("pc", "adaptive"), ("controller", "plain")]
)
@pytest.mark.parametrize("begins", ["at the touch", "while it holds"])
def test_a_stall_neither_presses_nor_lifts(
    monkeypatch: pytest.MonkeyPatch, host: Any, law: Any, direction: str, stall_ms: int, begins: str
) -> None:
    """From the touch on, or with an error for the whole of it: the set point is just halved."""
    monkeypatch.setattr(virtual, "LockStepLink", StallingWire)
    lab = Lab(TCP_CELL)
    arm = lab.cell.arm

    def true_N() -> float:
        return float(arm.true_wrench().force_N[2])

    def start(setpoint_N: float) -> None:
        request = ForceStartRequest(mode="position", host=host, law=law, setpoint_N=setpoint_N)
        assert lab.ask(topics.FORCE_START, request).accepted

    def extremes_N(seconds: float) -> tuple[float, float]:
        forces_N = []
        for _ in range(round(seconds * 1e3)):
            lab.cell.advance(0.001)
            forces_N.append(true_N())
        return min(forces_N), max(forces_N)

    goal_N, found_N = SETPOINT_N, 0.5  # of the touch
    start(SETPOINT_N)
    if begins == "while it holds":
        goal_N, found_N = 0.5 * SETPOINT_N, 0.98 * SETPOINT_N
    lab.seconds_until(lambda: true_N() > found_N, 3.0)
    if begins == "while it holds":
        lab.cell.advance(0.3)
        start(goal_N)
    until_ns = lab.cell.clock.now_ns() + round(stall_ms * 1e-3 * NS_PER_S)
    setattr(StallingWire.newest, f"{direction}_until_ns", until_ns)
    assert extremes_N(stall_ms / 1e3 + 0.5)[1] <= MAX_N
    least_N, most_N = extremes_N(0.5)
    assert least_N >= MIN_N
    assert most_N <= MAX_N
    if lab.status.state not in {"HOLDING", "FAULT"}:
        lab.cell.advance(1.0)
        assert true_N() == pytest.approx(goal_N, abs=1.0)

"""The regulator on the bus: start and stop by request, refusals with a reason, gains."""

from typing import Any

import numpy as np
import pytest

from common.motion.convert import pose_of
from forcemesh import topics
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest
from services.regulator.law import LawSettings
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import (
    BOTH_HOSTS,
    KI,
    PERIOD_S,
    T_FLANGE_TCP,
    RegulatorBench,
    assert_stopped,
)
from tuning.gain_rule import tune


@pytest.fixture
def bench() -> RegulatorBench:
    """Return a regulator that has not been started."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    return bench


def test_it_publishes_every_period_while_it_is_stopped(bench: RegulatorBench) -> None:
    """The target is not valid and stopped, with the sample it is based on; silence means death.

    Each wrench triggers a step: the loop does not wait for a period.
    """
    assert bench.service.trigger is not None
    assert bench.service.trigger.topic is topics.WRENCH
    for _ in range(10):
        bench.step()
        reading = bench.out.read(bench.clock.now_ns())
        assert (reading.age_s, reading.origin) == (0.0, bench.origin)
        assert_stopped(bench, "stopped")


@pytest.mark.parametrize("mode", ["position", "orientation", "both"])
@pytest.mark.parametrize("force_N", [0.0, 30.0])
def test_it_starts_at_the_measured_pose(bench: RegulatorBench, mode: Any, force_N: float) -> None:
    """The first pose is the measured one, for any wrench."""
    bench.push((force_N, 0.0, force_N), (1.0, 0.0, 0.0))
    bench.step()
    assert bench.start(ForceStartRequest(mode=mode, setpoint_N=10.0)).accepted
    target = bench.published()
    assert (target.valid, target.mode, target.host) == (True, mode, "pc")
    assert target.pose is not None
    assert pose_of(target.pose).homogeneous == pytest.approx(T_START.homogeneous, abs=1e-12)


def test_stop_ends_it_and_a_new_start_begins_at_the_arm(bench: RegulatorBench) -> None:
    """The last proposal is dropped."""
    bench.push((0.0, 0.0, 20.0))
    bench.start()
    bench.pass_s(0.5)
    assert bench.ask(topics.FORCE_STOP, Empty()).accepted
    bench.step()
    assert_stopped(bench, "stopped")
    assert bench.start().accepted
    start = (T_START * T_FLANGE_TCP).translation
    assert bench.T_base_tcp().translation == pytest.approx(start, abs=1e-12)


def test_another_mode_or_set_point_continues_without_a_step(bench: RegulatorBench) -> None:
    """While it runs the pose continues from where it was, the set point on a ramp."""
    bench.push((0.0, 0.0, 5.0))
    bench.start()
    bench.pass_s(0.5)
    before = bench.T_base_tcp().translation
    errors = [bench.published().error_force_N[2]]
    assert bench.start(ForceStartRequest(mode="both", setpoint_N=20.0)).accepted
    assert np.linalg.norm(bench.T_base_tcp().translation - before) < 1e-4
    ramp_s = 20.0 / CELL.force.setpoint_ramp_N_s
    errors.append(bench.published().error_force_N[2])
    for _ in range(round(ramp_s / PERIOD_S) + 5):
        bench.step()
        errors.append(bench.published().error_force_N[2])
    assert max(np.abs(np.diff(errors))) <= CELL.force.setpoint_ramp_N_s * PERIOD_S + 1e-9
    assert errors[-1] == pytest.approx(5.0 - 20.0 + CELL.force.deadband_N)


@pytest.mark.parametrize(
    ("measured_N", "setpoint_N", "begins_N"),
    [(15.0, 25.0, 15.0), (15.0, 10.0, 10.0), (15.0, 0.0, 0.0), (0.0, 20.0, 0.0), (-3.0, 20.0, 0.0)],
    ids=["more", "less", "release", "from the air", "pulled"],
)
def test_the_set_point_ramp_begins_at_the_measured_force(
    bench: RegulatorBench, measured_N: float, setpoint_N: float, begins_N: float
) -> None:
    """An arm that presses does not release first, and a release does not wait for a ramp."""
    bench.push((0.0, 0.0, measured_N))
    bench.start(ForceStartRequest(mode="position", setpoint_N=setpoint_N))
    bench.step()
    band_N, step_N = CELL.force.deadband_N, CELL.force.setpoint_ramp_N_s * PERIOD_S
    ramp_error_N = measured_N - min(begins_N + step_N, setpoint_N)
    error_N = np.sign(ramp_error_N) * max(abs(ramp_error_N) - band_N, 0.0)
    assert bench.published().error_force_N[2] == pytest.approx(error_N, abs=step_N)


@pytest.mark.parametrize("stiffer", [0.0, 0.3, 1.0, 3.0])
def test_the_controller_approaches_no_faster_than_the_law_on_the_pc(stiffer: float) -> None:
    """Its speed is gain times set point: until the touch the sent set point is lower.

    Without gain it stands, whatever the set point.
    """
    bench = RegulatorBench(BOTH_HOSTS)
    bench.pass_s(0.1)
    gain = stiffer * KI
    assert bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(gain,) * 3)).accepted
    request = ForceStartRequest(mode="position", host="controller", setpoint_N=30.0)
    assert bench.start(request).accepted
    bench.pass_s(1.0)
    limit_N = LawSettings.of(CELL).approach_m_s / gain if gain else 30.0
    assert sent_setpoint_N(bench) == pytest.approx(min(limit_N, 30.0), rel=1e-3)
    bench.push((0.0, 0.0, 5.0))
    before_N = sent_setpoint_N(bench)
    for _ in range(60):
        bench.step()
        assert (
            -1e-9
            <= sent_setpoint_N(bench) - before_N
            <= CELL.force.setpoint_ramp_N_s * PERIOD_S + 1e-9
        )
        before_N = sent_setpoint_N(bench)
    assert before_N == pytest.approx(30.0)


def sent_setpoint_N(bench: RegulatorBench) -> float:
    """Return the set point that is sent to the controller."""
    feedback = bench.published().feedback
    assert feedback is not None
    return float(np.linalg.norm(feedback.setpoint_force_N))


def test_gains_are_set_by_request_and_the_rest_keeps_its_value(bench: RegulatorBench) -> None:
    """One kind of gain changes, on a ramp and without a step; the reply lists all."""
    bench.push((0.0, 0.0, 5.0 + CELL.force.deadband_N), (0.5, 0.0, 0.0))
    bench.start(ForceStartRequest(mode="orientation"))
    reply = bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI)))
    assert reply.accepted
    assert reply.gains is not None
    assert reply.gains.force_i_m_per_Ns == (0.0, 0.0, 2.0 * KI)
    assert reply.gains.torque_i_rad_per_Nms == tune(CELL).gains.torque_i_rad_per_Nms
    assert reply.gains.force_p_m_per_N == (0.0, 0.0, 0.0)
    assert not reply.text
    with_preset = GainsRequest(preset="stiff", force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI))
    reply = bench.ask(topics.GAINS, with_preset)  # single gains take precedence
    assert reply.gains == tune(CELL, "stiff").gains.replaced(force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI))
    bench.start()
    bench.pass_s(1.0)
    before = bench.T_base_tcp().translation[2]
    bench.pass_s(0.5)
    assert bench.T_base_tcp().translation[2] - before == pytest.approx(5.0 * KI, rel=0.02)

"""The regulator on the bus: started and stopped by request, refused with a reason, tuned."""

from typing import Any

import numpy as np
import pytest

from common.motion.convert import pose_of
from common.motion.frames import rotation_between
from forcemesh import topics
from forcemesh.bus import Origin
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest
from services.regulator.settings import law_settings
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import (
    KI,
    PERIOD_S,
    T_FLANGE_TCP,
    RegulatorBench,
    assert_stopped,
)
from tuning.gain_rule import tune

TWO_HOSTS = CELL.robot.model_copy(update={"hosts": ("pc", "controller")})


@pytest.fixture
def bench() -> RegulatorBench:
    """A regulator that nobody has started."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    return bench


# --- start and stop -------------------------------------------------------------------------------


def test_every_wrench_wakes_it(bench: RegulatorBench) -> None:
    """Its trigger is its main input: no period of waiting in the loop."""
    assert bench.service.trigger is not None
    assert bench.service.trigger.topic is topics.WRENCH


def test_it_speaks_every_period_while_it_is_stopped(bench: RegulatorBench) -> None:
    """Not valid and stopped, with the sample behind it: silence would look like death."""
    for _ in range(10):
        bench.step()
        reading = bench.out.read(bench.clock.now_ns())
        assert (reading.age_s, reading.origin) == (0.0, Origin(77, 8))
        assert_stopped(bench, "stopped")


@pytest.mark.parametrize("mode", ["position", "orientation", "both"])
@pytest.mark.parametrize("force_N", [0.0, 30.0])
def test_it_starts_where_the_arm_is(bench: RegulatorBench, mode: Any, force_N: float) -> None:
    """The first pose is the measured one, whatever the wrench is at that moment."""
    bench.push((force_N, 0.0, force_N), (1.0, 0.0, 0.0))
    bench.step()
    assert bench.start(ForceStartRequest(mode=mode, setpoint_N=10.0)).accepted
    said = bench.said()
    assert (said.valid, said.mode, said.host) == (True, mode, "pc")
    assert said.pose is not None
    assert pose_of(said.pose).homogeneous == pytest.approx(T_START.homogeneous, abs=1e-12)


def test_the_target_carries_the_set_point_and_the_law(bench: RegulatorBench) -> None:
    """What was asked for, not what the ramp has come to; nothing while it is stopped."""
    bench.step()
    assert (bench.said().setpoint_N, bench.said().law) == (None, None)
    bench.push((0.0, 0.0, 5.0))
    bench.start(ForceStartRequest(mode="position", setpoint_N=15.0))
    bench.pass_s(0.05)
    assert (bench.said().setpoint_N, bench.said().law) == (15.0, CELL.force.law)
    bench.start(ForceStartRequest(mode="position", setpoint_N=25.0, law="plain"))
    bench.pass_s(0.05)
    assert (bench.said().setpoint_N, bench.said().law) == (25.0, "plain")


def test_position_moves_the_flange_along_the_force_at_the_tuned_rate(bench: RegulatorBench) -> None:
    """After a second at 5 N beyond the deadband: Ki 5 N 1 s upwards, no turn."""
    bench.push((0.0, 0.0, 5.0 + CELL.force.deadband_N))
    bench.start()
    bench.pass_s(1.0)
    moved = bench.T_base_tcp().translation - (T_START * T_FLANGE_TCP).translation
    assert moved == pytest.approx([0.0, 0.0, 5.0 * KI], rel=0.01, abs=1e-9)
    assert bench.said().error_force_N == pytest.approx((0.0, 0.0, 5.0))


def test_orientation_turns_the_flange_about_the_tcp(bench: RegulatorBench) -> None:
    """The TCP stays to a nanometre while the flange swings round it."""
    bench.push((0.0, 0.0, 30.0), (0.3, -0.2, 0.1))
    bench.start(ForceStartRequest(mode="orientation"))
    bench.pass_s(0.3)
    T = bench.T_base_tcp()
    turned = rotation_between(T_START.rotation, T.rotation)
    assert T.translation == pytest.approx((T_START * T_FLANGE_TCP).translation, abs=1e-9)
    assert np.linalg.norm(turned) > 0.03
    assert np.cross(turned, (0.3, -0.2, 0.1)) == pytest.approx(np.zeros(3), abs=1e-9)


def test_stop_ends_it_and_a_new_start_begins_at_the_arm(bench: RegulatorBench) -> None:
    """What was proposed last time is forgotten."""
    bench.push((0.0, 0.0, 20.0))
    bench.start()
    bench.pass_s(0.5)
    assert bench.ask(topics.FORCE_STOP, Empty()).accepted
    bench.step()
    assert_stopped(bench, "stopped")
    assert bench.start().accepted
    start = (T_START * T_FLANGE_TCP).translation
    assert bench.T_base_tcp().translation == pytest.approx(start, abs=1e-12)


def test_another_mode_or_set_point_goes_on_without_a_bump(bench: RegulatorBench) -> None:
    """Asked for while it runs: the pose goes on from where it was, the set point on a ramp."""
    bench.push((0.0, 0.0, 5.0))
    bench.start()
    bench.pass_s(0.5)
    before = bench.T_base_tcp().translation
    errors = [bench.said().error_force_N[2]]
    assert bench.start(ForceStartRequest(mode="both", setpoint_N=20.0)).accepted
    assert np.linalg.norm(bench.T_base_tcp().translation - before) < 1e-4
    ramp_s = 20.0 / CELL.force.setpoint_ramp_N_s
    errors.append(bench.said().error_force_N[2])
    for _ in range(round(ramp_s / PERIOD_S) + 5):
        bench.step()
        errors.append(bench.said().error_force_N[2])
    assert max(np.abs(np.diff(errors))) <= CELL.force.setpoint_ramp_N_s * PERIOD_S + 1e-9
    assert errors[-1] == pytest.approx(5.0 - 20.0 + CELL.force.deadband_N)


@pytest.mark.parametrize(
    ("felt_N", "wanted_N", "begins_N"),
    [(15.0, 25.0, 15.0), (15.0, 10.0, 10.0), (15.0, 0.0, 0.0), (0.0, 20.0, 0.0), (-3.0, 20.0, 0.0)],
    ids=["more", "less", "release", "from the air", "pulled"],
)
def test_the_set_point_begins_at_what_is_felt_already(
    bench: RegulatorBench, felt_N: float, wanted_N: float, begins_N: float
) -> None:
    """An arm that presses does not let go first, and a release does not wait for a ramp."""
    bench.push((0.0, 0.0, felt_N))
    bench.start(ForceStartRequest(mode="position", setpoint_N=wanted_N))
    bench.step()
    band_N, step_N = CELL.force.deadband_N, CELL.force.setpoint_ramp_N_s * PERIOD_S
    wants_N = felt_N - min(begins_N + step_N, wanted_N)
    error_N = np.sign(wants_N) * max(abs(wants_N) - band_N, 0.0)
    assert bench.said().error_force_N[2] == pytest.approx(error_N, abs=step_N)


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", ["BOOT", "IDLE", "HOLDING", "FAULT"])
def test_a_start_needs_an_armed_arbiter(bench: RegulatorBench, state: Any) -> None:
    """Refused in every other state, by its name."""
    bench.arbiter = ArbiterStatus(state=state)
    bench.step()
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, "not_armed")
    assert state in reply.text


def test_a_start_is_refused_while_the_operator_commands(bench: RegulatorBench) -> None:
    """A goal is on its way: it would be followed by a jump to where force feedback began."""
    bench.arbiter = ArbiterStatus(state="ACTIVE", commander="operator", lease=3)
    bench.step()
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, "busy")
    assert_stopped(bench, "stopped")


def test_a_host_that_the_cell_has_not_is_refused(bench: RegulatorBench) -> None:
    """The refusal says what would be needed and what there is."""
    reply = bench.start(ForceStartRequest(mode="position", host="controller"))
    assert (reply.accepted, reply.code) == (False, "host")
    assert "offers pc" in reply.text


def test_a_set_point_above_the_cells_is_refused_with_both_numbers(bench: RegulatorBench) -> None:
    """The limit itself is allowed."""
    most = CELL.force.setpoint_max_N
    reply = bench.start(ForceStartRequest(mode="position", setpoint_N=most + 0.1))
    assert (reply.accepted, reply.code) == (False, "setpoint")
    assert (reply.value, reply.limit) == (most + 0.1, most)
    assert bench.start(ForceStartRequest(mode="position", setpoint_N=most)).accepted


@pytest.mark.parametrize("topic", [topics.WRENCH, topics.ROBOT_STATE], ids=lambda t: t.key)
def test_a_start_needs_fresh_inputs(bench: RegulatorBench, topic: Any) -> None:
    """Refused with the name of what is stale."""
    bench.silent = {topic.key}
    bench.pass_s(0.2)
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, "stale")
    assert f"{topic.key} stale" in reply.text
    assert_stopped(bench, "stopped")


@pytest.mark.parametrize("stiffer", [0.3, 1.0, 3.0])
def test_the_controller_seeks_contact_no_faster_than_the_law_on_the_pc(stiffer: float) -> None:
    """It goes by gain times set point: until the tool touches, the set point is less than asked."""
    bench = RegulatorBench(CELL.model_copy(update={"robot": TWO_HOSTS}))
    bench.pass_s(0.1)
    gain = stiffer * KI
    assert bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(gain,) * 3)).accepted
    wanted = ForceStartRequest(mode="position", host="controller", setpoint_N=30.0)
    assert bench.start(wanted).accepted
    bench.pass_s(1.0)
    most_N = law_settings(CELL).approach_m_s / gain
    assert sought_N(bench) == pytest.approx(min(most_N, 30.0), rel=1e-3)
    bench.push((0.0, 0.0, 5.0))
    before_N = sought_N(bench)
    for _ in range(60):
        bench.step()
        assert -1e-9 <= sought_N(bench) - before_N <= CELL.force.setpoint_ramp_N_s * PERIOD_S + 1e-9
        before_N = sought_N(bench)
    assert before_N == pytest.approx(30.0)


def sought_N(bench: RegulatorBench) -> float:
    """Return the set point that the controller is sent."""
    feedback = bench.said().feedback
    assert feedback is not None
    return float(np.linalg.norm(feedback.setpoint_force_N))


# --- gains ----------------------------------------------------------------------------------------


def test_gains_are_set_by_request_and_the_rest_keeps_its_value(bench: RegulatorBench) -> None:
    """One kind of gain changes, on a ramp and without a bump; the reply lists all."""
    bench.push((0.0, 0.0, 5.0 + CELL.force.deadband_N), (0.5, 0.0, 0.0))
    bench.start(ForceStartRequest(mode="orientation"))
    reply = bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI)))
    assert reply.accepted
    assert reply.gains is not None
    assert reply.gains.force_i_m_per_Ns == (0.0, 0.0, 2.0 * KI)
    assert reply.gains.torque_i_rad_per_Nms == tune(CELL).gains.torque_i_rad_per_Nms
    assert reply.gains.force_p_m_per_N == (0.0, 0.0, 0.0)
    assert not reply.text
    reply = bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(0.0, 0.0, 20.0 * KI)))
    assert reply.accepted
    stiffness = CELL.contact.stiffness_N_m
    assert reply.text.startswith(f"unstable at contact.stiffness_N_m {stiffness:g} and")
    bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI)))
    bench.start()
    bench.pass_s(1.0)
    before = bench.T_base_tcp().translation[2]
    bench.pass_s(0.5)
    assert bench.T_base_tcp().translation[2] - before == pytest.approx(5.0 * KI, rel=0.02)

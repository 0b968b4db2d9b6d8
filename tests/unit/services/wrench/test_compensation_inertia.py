"""Inertia of the tool, subtracted from the reading where the cell file requires it."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import ZERO3
from forcemesh.requests import MoveRequest
from services.wrench.compensation import AccelerationEstimator, ReportedPosition
from tests.fakes.bench import CELL
from tests.fakes.lab import Lab
from tests.unit.common.config.test_load import DEMO

PERIOD_NS = round(1e9 / CELL.rates.robot_hz)
vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


def reading(p_m: np.ndarray, seq: int, *, at_s: float | None = None) -> ReportedPosition:
    """Return the position of the centre of mass at a report."""
    stamp_ns = seq * PERIOD_NS if at_s is None else round(at_s * 1e9)
    return ReportedPosition(1, seq, stamp_ns, p_m)


def estimate_of(reports: Sequence[ReportedPosition | None]) -> np.ndarray:
    """Return the estimated acceleration at the end of a motion."""
    acceleration = AccelerationEstimator(CELL)
    for report in reports:
        acceleration.update(report)
    return np.array(acceleration.now())


@given(vectors, vectors, st.floats(0.5, 2.0))
def test_a_constant_acceleration_is_estimated_at_any_rate_of_the_robot(
    v: np.ndarray, a: np.ndarray, slower: float
) -> None:
    """The period is measured, because a controller does not keep the rate of the cell file."""
    period_s = slower * PERIOD_NS / 1e9
    times = np.arange(30) * period_s
    path = [v * t + a * t * t / 2 for t in times]
    found = estimate_of([reading(p, k, at_s=times[k]) for k, p in enumerate(path)])
    assert found == pytest.approx(a, abs=1e-3)


def test_without_a_filter_three_reports_are_enough() -> None:
    """The shortest parabola; a delay of the filter is half of it."""
    unfiltered = load_cell(DEMO, {"filter.lowpass_s": 0.0, "filter.median": 1})
    for cell, needed in (
        (unfiltered, 3),
        (CELL, 2 * round(CELL.plant.filter_delay_s * CELL.rates.robot_hz) + 1),
    ):
        acceleration = AccelerationEstimator(cell)
        for k in range(needed):
            assert acceleration.now() == ZERO3
            acceleration.update(reading(np.array([0.004 * k * k, 0.0, 0.0]), k))
        assert acceleration.now() != ZERO3


def test_a_gap_another_writer_and_silence_restart_the_estimate() -> None:
    """Half of an old motion and half of a new one would be a jump."""
    path = [np.array([0.5 * (0.004 * k) ** 2 * 2.0, 0.0, 0.0]) for k in range(40)]
    known = [reading(p, k) for k, p in enumerate(path)]
    assert estimate_of(known)[0] == pytest.approx(2.0, abs=1e-3)
    assert estimate_of([*known[:20], *known[:3]]) == pytest.approx(0.0)
    assert estimate_of([*known[:20], *known[30:32]]) == pytest.approx(0.0)
    other = known[20]._replace(epoch=2)
    assert estimate_of([*known[:20], other]) == pytest.approx(0.0)
    assert estimate_of([*known[:20], None, *known[20:22]]) == pytest.approx(0.0)
    assert estimate_of([*known[:20], known[19], known[19]])[0] == pytest.approx(2.0, abs=1e-3)


def test_poses_with_constant_stamps_give_no_acceleration() -> None:
    """Constant stamps have no period."""
    assert estimate_of([reading(np.zeros(3), k, at_s=1.0) for k in range(20)]) == pytest.approx(0.0)


def residual_rms_N(*, inertial: bool) -> float:
    """Return the rms residual force [N] while the simulated arm swings its tool."""
    changes = {
        "filter.inertial": inertial,
        "sim.gap_m": 0.1,
        "limits.speed_m_s": 1.0,
        "sim.bias_force_N": [0.0, 0.0, 0.0],
        "payload.bias_force_N": [0.0, 0.0, 0.0],
        "payload.com_m": [0.012, -0.008, 0.055],
    }
    lab = Lab(load_cell(DEMO, changes))
    turn = tuple(np.radians([30.0, -3.0, 0.0, 20.0, -10.0, 60.0]).tolist())
    swing = MoveRequest(kind="by", joint_rad=turn, speed_m_s=0.5)
    assert lab.ask(topics.MOVE, swing).accepted
    forces_N = []
    for _ in range(400):
        lab.cell.advance(0.004)
        forces_N.append(np.linalg.norm(lab.now(lab.wrench).force_N))
    assert lab.status.trips == ()
    return float(np.sqrt(np.mean(np.square(forces_N))))


def test_a_swung_tool_weighs_no_more_than_at_rest() -> None:
    """In the whole cell, with sensor noise, less than a fifth of the motion's effect remains."""
    without, with_it = residual_rms_N(inertial=False), residual_rms_N(inertial=True)
    assert without > 0.5
    assert with_it < 0.2 * without

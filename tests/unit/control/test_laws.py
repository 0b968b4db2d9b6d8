"""The registry of the laws: a law of another package runs in the service as ours do."""

from dataclasses import dataclass, replace
from typing import Any

import pinocchio as pin
import pytest

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import scaled
from control.law import LawInput, LawMotion
from control.laws import LAWS, Law, refuse_unknown_law
from forcemesh.errors import ConfigError
from forcemesh.requests import ForceStartRequest
from tests.fakes.bench import CELL, DEMO
from tests.fakes.regulator_bench import PERIOD_S, FollowingBench

REQUEST = ForceStartRequest(mode="position", law="tiny", setpoint_N=10.0)


@dataclass(frozen=True, slots=True)
class TinyState:
    """Samples so far, and the stiffness that the service has given."""

    samples: int = 0


def begin(_command: pin.SE3, _measured: pin.SE3, _k: Any, _damping_Ns_m: float) -> TinyState:
    """Return the initial state."""
    return TinyState()


def step(state: TinyState, sample: LawInput, damping_Ns_m: float) -> tuple[TinyState, LawMotion]:
    """Yield to the force with a constant damping, whatever the set point."""
    motion = replace(
        sample.motion,
        shift_m=scaled(sample.force_N, sample.dt_s / damping_Ns_m),
        error_force_N=sample.force_N,
        error_torque_Nm=sample.torque_Nm,
    )
    return TinyState(state.samples + 1), motion


def damping_Ns_m(cell: CellConfig) -> float:
    """Return the only constant of the tiny law."""
    return 100.0 / cell.force.speed_max_m_s


TINY = Law(damping_Ns_m, begin, step)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> FollowingBench:
    """Return a regulator whose registry has the tiny law."""
    monkeypatch.setitem(LAWS, "tiny", TINY)
    return FollowingBench()


def test_a_law_is_one_row(bench: FollowingBench) -> None:
    """It starts, moves the arm at its own speed, and is in target and reply by its name."""
    bench.push((0.0, 10.0, 0.0))
    reply = bench.start(REQUEST)
    assert reply.accepted
    assert "law tiny" in reply.text
    before_m = bench.p_tcp_m
    bench.step(25)
    speed_m_s = (bench.p_tcp_m - before_m) / (25 * PERIOD_S)
    assert speed_m_s == pytest.approx([0.0, 10.0 / damping_Ns_m(CELL), 0.0], abs=1e-9)
    assert bench.published().law == "tiny"
    assert bench.published().error_force_N == (0.0, 10.0, 0.0)


def test_its_properties_decide_what_is_refused(bench, monkeypatch) -> None:
    """A law that does not cover the cell leaves it to plain."""
    remark = "never measured here"
    row = replace(TINY, covers=lambda _: False, remark=lambda _: remark)
    monkeypatch.setitem(LAWS, "tiny", row)
    reply = bench.start(REQUEST)
    assert "law plain" in reply.text
    assert reply.text.endswith(remark)
    bench.step()
    assert bench.published().law == "plain"


def test_a_cell_whose_law_does_not_exist_is_refused() -> None:
    """At the start of the regulator and by `forcemesh config check`, with the laws that do."""
    cell = load_cell(DEMO, {"force": {"law": "iron"}})
    with pytest.raises(ConfigError, match=f"force.law: must be {' or '.join(LAWS)}, found 'iron'"):
        refuse_unknown_law(cell, "demo.yaml")

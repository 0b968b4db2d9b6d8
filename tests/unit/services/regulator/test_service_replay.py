"""Deterministic replay: the regulator publishes the same bytes again."""

import json

import pytest

from forcemesh import topics
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, GainsRequest
from tests.fakes.bench import CELL
from tests.fakes.replay import Capture, replay
from tuning.gain_rule import tune

GAIN = tune(CELL).force_i_m_per_Ns
NEAR = CELL.model_copy(
    update={"sim": None if CELL.sim is None else CELL.sim.model_copy(update={"gap_m": 0.001})}
)


@pytest.fixture(scope="module")
def lines() -> list[str]:
    """Capture a run: approach, press, another mode, other gains, another law, stop."""
    capture = Capture(NEAR)
    capture.advance(1.6)
    capture.ask(topics.TARE, Empty())
    capture.ask(topics.ARM, ArmRequest())
    for request in (
        ForceStartRequest(mode="position", setpoint_N=20.0, law="adaptive"),
        ForceStartRequest(mode="both", setpoint_N=10.0, law="adaptive"),
        ForceStartRequest(mode="position", setpoint_N=5.0, law="plain"),
    ):
        capture.ask(topics.FORCE_START, request)
        capture.advance(0.8)
        capture.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(GAIN, GAIN, 0.5 * GAIN)))
        capture.advance(0.2)
    capture.ask(topics.FORCE_STOP, Empty())
    capture.advance(0.05)
    return capture.lines


def test_a_captured_run_gives_the_same_commands_byte_by_byte(lines) -> None:
    """The regulator publishes every target of the run again, byte by byte."""
    pairs = list(replay(lines, NEAR))
    assert len(pairs) > 700
    assert sum(b'"contact":"contact"' in recorded for recorded, _ in pairs) > 300
    assert [replayed for _, replayed in pairs] == [recorded for recorded, _ in pairs]


def test_another_wrench_gives_other_commands(lines) -> None:
    """The comparison can fail: 0.1 N more on every wrench is detected."""
    changed = []
    for line in lines:
        fields = json.loads(line)
        if fields.get("topic") == "demo/wrench":
            x, y, z = fields["force_N"]
            fields["force_N"] = (x, y, z + 0.1)
        changed.append(json.dumps(fields))
    assert any(replayed != recorded for recorded, replayed in replay(changed, NEAR))

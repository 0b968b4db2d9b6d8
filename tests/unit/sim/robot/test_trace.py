"""The trace of the simulated arm: every tick, at once."""

import numpy as np

from forcemesh.clock import ManualClock
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings
from sim.robot.trace import VARIABLE, read_trace, trace_from_environment


def test_every_tick_is_in_the_file_at_once(tmp_path, monkeypatch):
    """Time, tick, command and joints of each tick can be read while the arm still lives."""
    path, clock, arm = tmp_path / "trace", ManualClock(), SimArm(SimSettings(), seed=0)
    monkeypatch.setenv(VARIABLE, str(path))
    trace = trace_from_environment(arm, clock)
    assert trace is not None
    joints = []
    for tick in range(1, 4):
        arm.command_joints(arm.q_command + 1e-3)
        arm.step()
        clock.advance_ns(1_000_000)
        trace.ticked()
        joints.append(arm.q)
        assert len(read_trace(path)) == tick
    trace.close()
    records = read_trace(path)
    assert records["tick"].tolist() == [1, 2, 3]
    assert np.diff(records["at_ns"]).tolist() == [1_000_000, 1_000_000]
    assert records["command"][-1].tolist() == arm.q_command.tolist()
    assert np.array_equal(records["q"], joints)

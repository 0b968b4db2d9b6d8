"""The shipped program in the emulator and the real gateway, in lock step on a virtual clock."""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import record_of
from sim.controller.behaviour import Behaviour, pessimistic
from tests.contract.rig import Rig, pose_goal, shifted
from tests.contract.robots import GOOD, Both, Emulated


@pytest.mark.parametrize("behaviour", [GOOD, pessimistic(GOOD.step_s)], ids=["kind", "pessimistic"])
def test_a_goal_passes_gateway_and_program_and_is_reported_as_done(
    behaviour: Behaviour,
) -> None:
    """Hello, limits, command 1, LMOVE, MuJoCo, poses back, status bits, done; then it stays."""
    emulated = Emulated(behaviour)
    rig = emulated.rig
    assert rig.advance(5.0, lambda: rig.state.valid), rig.service.fault
    start = pin.SE3(rig.T)
    _goal_to(rig, 1, shifted(start, y_m=0.02, z_m=0.03))
    end = emulated.machine.robot.here()
    assert np.linalg.norm(end.translation - start.translation - [0, 0.02, 0.03]) < 2e-4
    assert emulated.machine.stops == []


def _goal_to(rig: Rig, id_: int, T: pin.SE3) -> None:
    """Arm, send a pose goal, wait until it is done; repeat it after a stall of the controller."""
    for _ in range(3):
        rig.arm()
        rig.send("goal", goal=pose_goal(id_, T))
        rig.advance(5.0, lambda: rig.state.goal.state in ("done", "refused"))
        if rig.state.goal.state == "done":
            return
        id_ += 1
    pytest.fail(f"{rig.state.goal} {rig.state.hold_reason}")


def test_two_runs_in_lock_step_are_the_same_to_the_last_bit() -> None:
    """Gateway, program and arm on one virtual clock: nothing depends on the machine's speed."""

    def end() -> tuple[bytes, int]:
        emulated = Emulated()
        rig = emulated.rig
        rig.connect()
        rig.arm()
        rig.send("setpoint", pose=record_of(shifted(rig.T, x_m=0.005)))
        rig.advance(0.5)
        return emulated.machine.robot.q.tobytes(), emulated.machine.steps

    assert end() == end()


def test_a_wire_that_is_cut_is_opened_again_and_nothing_moves_by_that() -> None:
    """The controller's program accepts the next connection; the arm stays until armed again."""
    emulated = Emulated()
    rig = emulated.rig
    assert rig.advance(5.0, lambda: rig.state.valid)
    rig.arm()
    rig.send("goal", goal=pose_goal(1, shifted(rig.T, z_m=0.05)))
    rig.advance(0.25)
    assert isinstance(rig.service, Both)
    wire = rig.service.gateway._connection._wire
    wire.close("cut by the test", rig.clock.now_ns())
    assert rig.advance(5.0, lambda: wire.connections == 2 and rig.state.valid)
    rig.advance(1.0)
    q = emulated.machine.robot.q
    rig.advance(2.0)
    assert np.abs(emulated.machine.robot.q - q).max() < 1e-5
    assert rig.state.hold_reason

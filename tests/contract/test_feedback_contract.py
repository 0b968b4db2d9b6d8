"""Force feedback on every robot that has it: directions, gains, speed and end conditions.

The wrench is published, not simulated by contact; the motion is measured on `robot/state` alone.
"""

import numpy as np
import pytest

from common.motion.frames import rotation_between
from forcemesh.messages import Gains, Mode, Vec3
from tests.contract.rig import Rig

RATE_M_S = 0.002  # gains below times the push
RATE_RAD_S = 0.04
FORCE_N, TORQUE_NM = 10.0, 1.0
GAINS = Gains(
    force_i_m_per_Ns=(RATE_M_S / FORCE_N,) * 3,
    torque_i_rad_per_Nms=(RATE_RAD_S / TORQUE_NM,) * 3,
)
SETTLE_S = 0.15  # covers the delays of all robots
RUN_S = 0.6
PURE_TURN_S = 0.1  # about the tool's axis the flange only turns: the shortest time of SPEED in s
PUSHES = [(0, 1), (1, 1), (2, 1), (2, -1)]  # base axis, sign


def unit(axis: int, size: float) -> Vec3:
    """A vector along a base axis."""
    x, y, z = (size if index == axis else 0.0 for index in range(3))
    return (x, y, z)


def change(rig: Rig, duration_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Advance the robot; return the travel [m] and rotation [rad] of its TCP in that time."""
    start, started_s = rig.T_tcp, rig.track[-1][0]
    rig.advance(duration_s)
    scale = duration_s / (rig.track[-1][0] - started_s)  # whole periods of the reports only
    end = rig.T_tcp
    moved_m = end.translation - start.translation
    return moved_m * scale, rotation_between(start.rotation, end.rotation) * scale


@pytest.fixture
def pushed(rig: Rig) -> Rig:
    """Return an armed robot without an external force."""
    rig.arm()
    rig.push()
    return rig


# --- directions -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "sign"), PUSHES)
def test_a_force_moves_the_arm_in_its_direction_at_gain_times_force(
    pushed: Rig, axis: int, sign: int
) -> None:
    """Base axes, sign and size; no sideways motion, no rotation, and a torque moves nothing."""
    rig = pushed
    rig.feed_back("position", GAINS)
    rig.push(unit(axis, sign * FORCE_N), unit(axis, TORQUE_NM))
    rig.advance(SETTLE_S)
    moved_m, turned_rad = change(rig, RUN_S)
    assert np.allclose(moved_m, unit(axis, sign * RATE_M_S * RUN_S), atol=1.2e-4)
    assert np.linalg.norm(turned_rad) < 2e-4


@pytest.mark.parametrize(("axis", "sign"), PUSHES)
def test_a_torque_turns_the_tool_about_its_centre_point(pushed: Rig, axis: int, sign: int) -> None:
    """About the base axis through the TCP of the cell file: the TCP stays, the flange turns."""
    rig = pushed
    rig.feed_back("orientation", GAINS)
    rig.push(unit(axis, FORCE_N), unit(axis, sign * TORQUE_NM))
    rig.advance(SETTLE_S if axis < 2 else SETTLE_S + 3 * PURE_TURN_S)
    flange = rig.T
    moved_m, turned_rad = change(rig, RUN_S)
    atol = 2.4e-3 if axis < 2 else RATE_RAD_S * PURE_TURN_S
    assert np.allclose(turned_rad, unit(axis, sign * RATE_RAD_S * RUN_S), atol=atol)
    assert np.linalg.norm(moved_m) < 1e-4
    lever_m = flange.rotation @ rig.cell.tool.T_flange_tcp.pose.translation
    swing_m = rig.T.translation - flange.translation
    assert np.allclose(swing_m, -np.cross(unit(axis, sign * RATE_RAD_S * RUN_S), lever_m),
                       atol=5e-4)  # fmt: skip


# --- gains and speed ------------------------------------------------------------------------------


def test_the_proportional_gain_acts_once_on_a_change_and_not_on_the_start(rig: Rig) -> None:
    """A force present at the start of feedback moves nothing; 10 N more move 0.15 mm, once."""
    rig.arm()
    rig.push(unit(2, 5.0))
    start = rig.T_tcp
    rig.feed_back("position", Gains(force_p_m_per_N=(1.5e-5,) * 3))
    rig.advance(SETTLE_S)
    assert np.linalg.norm(rig.T_tcp.translation - start.translation) < 4e-5
    rig.push(unit(2, 15.0))
    rig.advance(2 * SETTLE_S)
    assert np.allclose(rig.T_tcp.translation - start.translation, (0, 0, 1.5e-4), atol=4e-5)


@pytest.mark.parametrize("mode", ["position", "orientation"])
def test_no_gain_makes_it_faster_than_the_speed_limit(pushed: Rig, mode: Mode) -> None:
    """The highest permitted gains are a steady ramp below the limit.

    The margin depends on the controller: the emulated one counts a rotation on 0.24 m, so that 50
    mm/s are 0.21 rad/s.
    """
    rig = pushed
    rig.feed_back(mode, Gains(force_i_m_per_Ns=(0.09,) * 3, torque_i_rad_per_Nms=(1.7,) * 3))
    rig.track.clear()
    rig.push(unit(2, 20.0), unit(2, 2.0))
    rig.advance(0.5)
    limit_m_s, limit_rad_s = rig.cell.force.speed_max_m_s, rig.cell.force.speed_max_rad_s
    travel_m, turn_rad = rig.fastest(0.3)
    if mode == "position":
        assert 0.7 * limit_m_s < travel_m / 0.3 < 1.1 * limit_m_s
    else:
        assert 0.35 * limit_rad_s < turn_rad / 0.3 < 1.1 * limit_rad_s
